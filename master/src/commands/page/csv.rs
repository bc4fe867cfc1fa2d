//! Tables as files for other programs.

use std::io::{self, Write};

/// Writes a head and rows as RFC 4180 says, but with lines that end as everywhere on Unix. Nothing of a cell is lost or changed: one
/// with a comma, a quote or a line end is put in quotes.
pub fn write_csv<R, C>(
    to: &mut impl Write,
    columns: impl IntoIterator<Item: AsRef<str>>,
    rows: impl IntoIterator<Item = R>,
) -> io::Result<()>
where
    R: IntoIterator<Item = C>,
    C: AsRef<str>,
{
    write_row(to, columns)?;
    rows.into_iter().try_for_each(|row| write_row(to, row))
}

fn write_row(to: &mut impl Write, cells: impl IntoIterator<Item: AsRef<str>>) -> io::Result<()> {
    let mut cells = cells.into_iter().enumerate().peekable();
    while let Some((k, cell)) = cells.next() {
        let cell = cell.as_ref();
        let comma = if k == 0 { "" } else { "," };
        // A line without anything is no row to some readers.
        let is_alone = k == 0 && cells.peek().is_none();
        if cell.contains([',', '"', '\n', '\r']) || (cell.is_empty() && is_alone) {
            write!(to, "{comma}\"{}\"", cell.replace('"', "\"\""))?;
        } else {
            write!(to, "{comma}{cell}")?;
        }
    }
    writeln!(to)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn csv(columns: &[&str], rows: &[&[&str]]) -> String {
        let mut bytes = Vec::new();
        write_csv(&mut bytes, columns, rows.iter().map(|row| row.iter())).unwrap();
        String::from_utf8(bytes).unwrap()
    }

    #[test]
    fn cells_are_quoted_where_they_must_be() {
        let rows: [&[&str]; 3] = [&["1", "a,b"], &["say \"no\"", "two\nlines"], &["", " as it is "]];
        assert_eq!(
            csv(&["n", "what"], &rows),
            "n,what\n1,\"a,b\"\n\"say \"\"no\"\"\",\"two\nlines\"\n, as it is \n"
        );
        assert_eq!(csv(&["one"], &[&[""], &["\r"]]), "one\n\"\"\n\"\r\"\n");
        assert_eq!(csv(&["a", "b"], &[]), "a,b\n");
    }
}
