//! `tessera scene info` for people.

use super::info::{Codes, Info, TreeLine};
use std::fmt::Write;
use tessera_master::report::{bytes, write_lists};

/// The report as text.
pub fn text(info: &Info) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write_all(info, &mut text);
    text
}

fn write_all(info: &Info, t: &mut String) -> std::fmt::Result {
    writeln!(t, "scene      {}", info.scene)?;
    writeln!(t, "pack id    {}, {}", info.pack_id, bytes(info.bytes.pack))?;
    writeln!(
        t,
        "geometry   {} triangles, {} vertices; {} meshes on {} nodes",
        info.triangles, info.vertices, info.meshes, info.nodes_in_tree
    )?;
    writeln!(
        t,
        "packed     {} triangles, {} vertices, nv/nf {:.3}",
        info.triangles_packed, info.vertices_packed, info.nv_nf
    )?;
    names(t, "materials", info.materials, &info.material_names)?;
    let images: Vec<_> = info.images.iter().map(|i| format!("{} {}x{}", i.name, i.width, i.height)).collect();
    names(t, "textures", info.textures, &images)?;
    names(t, "lights", info.lights, &info.light_names)?;
    names(t, "cameras", info.cameras.len(), &info.cameras)?;
    writeln!(t, "codes      {}", codes(&info.codes))?;
    writeln!(t, "kernel     {}", kernel(&info.kernel.name, &info.kernel.left_out))?;
    for (what, count) in info.dropped.iter().filter(|(_, count)| **count > 0) {
        writeln!(t, "dropped    {count} {what}")?;
    }
    write_lists(t, &info.left_out, &info.warnings, &info.notes)?;
    writeln!(t, "time       read {:.0} ms, pack {:.0} ms", info.ms.read, info.ms.pack)?;
    tables(info, t)?;
    if info.side_uv_triangles + info.split_vertices > 0 {
        writeln!(
            t,
            "\nTexture coordinates: {} vertices split for their shifts, {} triangles in the side table",
            info.split_vertices, info.side_uv_triangles
        )?;
    }
    if info.lost_area > 0.0 {
        writeln!(t, "\nTriangles that collapsed when quantised had an area of {:.3e}", info.lost_area)?;
    }
    writeln!(t, "\nSections of the pack")?;
    for (name, length) in &info.sections {
        writeln!(t, "  {name:<10} {:>12}", bytes(*length))?;
    }
    for line in &info.sections_left_out {
        writeln!(t, "  {:<10} {:>12}   {}", line.section, "none", line.why)?;
    }
    if let Some(why) = &info.why {
        why.write(t)?;
    }
    Ok(())
}

/// The rows of the paper's tables, for this build.
fn tables(info: &Info, t: &mut String) -> std::fmt::Result {
    let (nv, nf, nv_nf) = (info.vertices_packed, info.triangles_packed, info.nv_nf);
    let ratio = |from: u64, to: u64| from as f64 / to.max(1) as f64;

    writeln!(t, "\nTable 1, the mesh                   nv {nv}, nf {nf}, nv/nf {nv_nf:.3}")?;
    writeln!(t, "  32 nv + 12 nf + 8                 {}", mib(info.formulae.mesh_plain))?;
    writeln!(t, "  as plain f32, what it has of it   {}", mib(info.bytes.mesh_plain))?;

    let g = &info.grid;
    writeln!(t, "Table 2, the grid")?;
    writeln!(
        t,
        "  cells {} x {} x {}, {} hold a vertex (at most 65536), {:.1} triangles each",
        g.nx,
        g.ny,
        g.nz,
        g.cells,
        nf as f64 / g.cells.max(1) as f64
    )?;
    writeln!(t, "  precision {:.3e} of the longest side, voxel side {:.6e}", g.precision, g.step)?;

    writeln!(t, "Table 3, the mesh quantised                         ratio   (nv/nf {nv_nf:.3})")?;
    let (plain, f) = (info.formulae.mesh_plain, &info.formulae);
    let mut row =
        |what: &str, from: u64, to: u64| writeln!(t, "  {what:<33} {}   {:.3}", mib(to), ratio(from, to));
    row("12 nv + 12 nf", plain, f.mesh_packed)?;
    row("+ 18 * 2^16 + 24 for its tables", plain, f.mesh_packed_with_tables)?;
    row("this build, what the mesh has", info.bytes.mesh_plain, info.bytes.mesh_packed)?;
    row("this build, with its tables", info.bytes.mesh_plain, info.bytes.mesh_packed + info.bytes.tables)?;
    writeln!(
        t,
        "  limit for large meshes, 1 + (5/3) / (1 + nf/nv)   {:.3}",
        1.0 + (5.0 / 3.0) / (1.0 + 1.0 / nv_nf)
    )?;

    let standard = info.trees[0];
    writeln!(t, "Table 5(a), the kd-tree                             ratio   paper's layout   build")?;
    for tree in &info.trees {
        writeln!(
            t,
            "  {:<33} {}   {:.3}   {}   {:>6.0} ms",
            kind(tree),
            mib(tree.bytes),
            ratio(standard.bytes, tree.bytes),
            mib(tree.bytes_formula),
            tree.build_ms
        )?;
    }
    writeln!(
        t,
        "  paper's layout: 8 B an inner node or leaf, 16 B an inner node with references, 4 B a leaf reference"
    )?;
    writeln!(
        t,
        "Table 5(b), its nodes         inner 0       inner 1       inner 2        leaves   leaf refs"
    )?;
    for tree in &info.trees {
        let n = tree.nodes;
        writeln!(
            t,
            "  {:<24} {:>12}  {:>12}  {:>12}  {:>12}  {:>10}   {} empty, depth {}, leaves = inner + {}",
            kind(tree),
            n.inner0,
            n.inner1,
            n.inner2,
            n.leaves,
            n.leaf_refs,
            n.empty_leaves,
            n.depth,
            n.leaves as i128 - i128::from(n.inner0 + n.inner1 + n.inner2)
        )?;
    }

    writeln!(t, "Table 6, mesh and kd-tree                           ratio   (nv/nf {nv_nf:.3})")?;
    let before = info.bytes.mesh_plain + standard.bytes;
    writeln!(t, "  plain mesh, standard tree         {}   1.000", mib(before))?;
    for tree in &info.trees {
        let after = info.bytes.mesh_packed + info.bytes.tables + tree.bytes;
        let what = format!("quantised mesh, {}", kind(tree));
        writeln!(t, "  {what:<33} {}   {:.3}", mib(after), ratio(before, after))?;
    }
    Ok(())
}

/// How vertices are coded.
fn codes(codes: &Codes) -> String {
    let mut text = match (codes.positions, codes.position_bits) {
        ("f32", _) => "positions f32".into(),
        (_, Some(bits)) => format!("positions in cells, {bits} bits an axis"),
        (_, None) => "positions in cells".into(),
    };
    text += &match (codes.normals, codes.normals_error, codes.normal_table) {
        (None, ..) => "; no normals".into(),
        (Some(code), None, _) => format!("; normals {code}"),
        (Some(code), Some(error), 0) => {
            format!("; normals {code}, 16 bits, within {error:.3} degrees, no table")
        }
        (Some(code), Some(error), table) => {
            format!("; normals {code}, 16 bits, within {error:.3} degrees, a table of {}", bytes(table))
        }
    };
    text += &match (codes.uv, codes.uv_bits) {
        (None, _) => "; no texture coordinates".into(),
        (Some("f32"), _) => "; texture coordinates f32".into(),
        (_, Some(bits)) => format!("; texture coordinates 1 + {} bits", bits - 1),
        (_, None) => "; texture coordinates in fixed point".to_owned(),
    };
    text
}

/// A GPU's kernel, and what is not in it.
pub fn kernel(name: &str, left_out: &[&str]) -> String {
    if left_out.is_empty() {
        return format!("{name}, nothing left out");
    }
    format!("{name}, left out: {}", left_out.join(", "))
}

fn kind(tree: &TreeLine) -> &'static str {
    match tree.refs {
        0 => "standard",
        1 => "one reference",
        _ => "two references",
    }
}

fn mib(n: u64) -> String {
    format!("{:>10.3} MiB", n as f64 / 1_048_576.0)
}

/// A count and as many names as fit a line or two.
fn names(t: &mut String, what: &str, count: usize, names: &[String]) -> std::fmt::Result {
    const SHOWN: usize = 8;
    write!(t, "{what:<10} {count}")?;
    let shown: Vec<_> =
        names.iter().take(SHOWN).map(|n| if n.is_empty() { "(unnamed)" } else { n }).collect();
    if !shown.is_empty() {
        write!(t, ": {}", shown.join(", "))?;
    }
    if names.len() > SHOWN {
        write!(t, ", ... (all with --json)")?;
    }
    writeln!(t)
}
