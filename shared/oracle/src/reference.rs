//! Pictures of the oracle that are kept in files, each with the key of what it shows.

use crate::digest::Digest;
use crate::{LayersError, OracleImage, VERSION, View};
use exr::prelude::{
    AnyChannel, AnyChannels, AttributeValue, Blocks, Compression, Encoding, Error, FlatSamples, Image, Layer,
    LayerAttributes, LineOrder, MetaData, ReadChannels, ReadLayers, Text, Vec2, WritableImage, read,
};
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{BufReader, BufWriter, Read as _, Write as _};
use std::path::{Path, PathBuf};
use tessera_geometry::CameraPose;
use tessera_scene::Without;

/// All that a picture depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Key {
    /// [`Oracle::content_hash`](crate::Oracle::content_hash).
    pub scene: [u8; 32],
    /// What was left out of it.
    pub without: Without,
    /// The view.
    pub view: View,
}

/// A picture and what it shows. Its file is an EXR of the channels that `tessera render --out x.exr` writes, which any viewer shows,
/// with the key as the text attribute [`Reference::ATTRIBUTE`]; colours, depths and normals are rounded to `f32`.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// What it shows.
    pub key: Key,
    /// The picture.
    pub image: OracleImage,
}

/// Why a file cannot serve as a reference; each message says what and what to do.
#[derive(Debug, thiserror::Error)]
pub enum ReferenceError {
    /// There is no such file.
    #[error("{}: there is no such file: render the reference first", path.display())]
    Missing {
        /// The file.
        path: PathBuf,
    },
    /// It cannot be read or written.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// It is no whole EXR file of a reference.
    #[error("{}: {what}; delete it and render the reference again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// It shows something else than was asked for.
    #[error("{}: is a reference of {setting} {found}, and {wanted} was asked for; render one for these settings", path.display())]
    Differs {
        /// The file.
        path: PathBuf,
        /// What differs first.
        setting: &'static str,
        /// In the file.
        found: String,
        /// In the key.
        wanted: String,
    },
}

/// Channels in the order of the words of [`OracleImage::to_layers`]; the last holds `u32`, the others `f32`.
const CHANNELS: [&str; 9] =
    ["R", "G", "B", "A", "depth.Z", "normal.X", "normal.Y", "normal.Z", "id.triangle"];

/// Bytes of a file beside twice its pixels' own: what the format adds to numbers that do not compress, its tables and its header.
const FILE_SPARE: u64 = 1 << 20;

impl Key {
    /// Settings by name, in the order in which they are compared; numbers of the view also bit by bit.
    fn settings(&self) -> [(&'static str, String); 14] {
        let View { pose, width, height, samples, depth, min_weight } = self.view;
        let CameraPose { eye, target, up, fov_degrees } = pose;
        let exact = |values: &[f64]| {
            let shown: Vec<_> = values.iter().map(f64::to_string).collect();
            let bits: Vec<_> = values.iter().map(|value| format!("{:016x}", value.to_bits())).collect();
            format!("{} [{}]", shown.join(","), bits.join(","))
        };
        let switch = |is_left_out: bool| if is_left_out { "left out" } else { "on" }.to_owned();
        let scene = self.scene.iter().fold(String::new(), |mut text, byte| {
            // Writing to a string does not fail.
            let _ = write!(text, "{byte:02x}");
            text
        });
        [
            ("oracle version", VERSION.to_string()),
            ("width", width.to_string()),
            ("height", height.to_string()),
            ("samples", samples.to_string()),
            ("depth", depth.to_string()),
            ("least weight", exact(&[min_weight])),
            ("eye", exact(&eye.to_array())),
            ("target", exact(&target.to_array())),
            ("up", exact(&up.to_array())),
            ("field of view", exact(&[fov_degrees])),
            ("textures", switch(self.without.textures)),
            ("shadows, reflection", {
                format!("{}, {}", switch(self.without.shadows), switch(self.without.reflection))
            }),
            ("refraction", switch(self.without.refraction)),
            ("scene", scene),
        ]
    }

    /// A line for each setting.
    fn text(&self) -> String {
        self.settings().iter().map(|(name, value)| format!("{name}: {value}\n")).collect()
    }
}

impl Reference {
    /// The attribute that holds the key.
    pub const ATTRIBUTE: &str = "tesseraOracle";

    /// Where the reference of `key` lies in a folder of references: its name is a hash of the key.
    pub fn path_in(folder: &Path, key: &Key) -> PathBuf {
        let mut digest = Digest::new("tessera reference");
        digest.bytes(key.text().as_bytes());
        let mut name = String::from("oracle-");
        for byte in &digest.finish()[..16] {
            // Writing to a string does not fail.
            let _ = write!(name, "{byte:02x}");
        }
        folder.join(name + ".exr")
    }

    /// Writes it, first beside `path`, so that no half a file ever has that name. The folder is made if need be.
    ///
    /// # Errors
    /// [`ReferenceError::File`].
    pub fn save(&self, path: &Path) -> Result<(), ReferenceError> {
        let failed = |source| ReferenceError::File { path: path.to_owned(), source };
        if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            fs::create_dir_all(folder).map_err(failed)?;
        }
        let mut beside = path.as_os_str().to_owned();
        beside.push(format!(".{}.part", std::process::id()));
        let beside = PathBuf::from(beside);
        let written = self.write(&beside).and_then(|()| fs::rename(&beside, path));
        if written.is_err() {
            // What is left is none's.
            let _ = fs::remove_file(&beside);
        }
        written.map_err(failed)
    }

    fn write(&self, path: &Path) -> std::io::Result<()> {
        let rows = self.image.to_layers();
        let words = |channel: usize| {
            rows.chunks_exact(36).map(move |pixel| {
                let at = channel * 4;
                u32::from_le_bytes([pixel[at], pixel[at + 1], pixel[at + 2], pixel[at + 3]])
            })
        };
        let channels = CHANNELS.iter().enumerate().map(|(index, &name)| {
            let sample_data = if name == "id.triangle" {
                FlatSamples::U32(words(index).collect())
            } else {
                FlatSamples::F32(words(index).map(f32::from_bits).collect())
            };
            // Only colours may be coded by how they look; the rest is plain data.
            let quantize_linearly = !matches!(name, "R" | "G" | "B");
            AnyChannel { name: Text::from(name), sample_data, quantize_linearly, sampling: Vec2(1, 1) }
        });
        let mut attributes = LayerAttributes {
            software_name: Some(Text::from("tessera oracle")),
            ..LayerAttributes::default()
        };
        let key = AttributeValue::Text(Text::from(self.key.text().as_str()));
        attributes.other.insert(Text::from(Self::ATTRIBUTE), key);
        let encoding = Encoding {
            compression: Compression::ZIP16,
            blocks: Blocks::ScanLines,
            line_order: LineOrder::Increasing,
        };
        let size = Vec2(self.image.width as usize, self.image.height as usize);
        let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(channels.collect()));
        let mut file = BufWriter::new(File::create(path)?);
        let written = Image::from_layer(layer).write().non_parallel().to_buffered(&mut file);
        written.map_err(|error| match error {
            Error::Io(error) => error,
            other => std::io::Error::other(other.to_string()),
        })?;
        file.flush()?;
        file.get_ref().sync_all()
    }

    /// Reads the reference of `key` from `path`. The header is held to the key before memory is reserved for the pixels.
    ///
    /// # Errors
    /// A file that is missing or damaged, shows something else than `key` says, or holds colours that are no finite numbers.
    pub fn load(path: &Path, key: &Key) -> Result<Self, ReferenceError> {
        let failed = |source: std::io::Error| match source.kind() {
            std::io::ErrorKind::NotFound => ReferenceError::Missing { path: path.to_owned() },
            _ => ReferenceError::File { path: path.to_owned(), source },
        };
        let damaged = |what: String| ReferenceError::Damaged { path: path.to_owned(), what };

        // Believe no length but that of the picture that is asked for.
        let View { width, height, .. } = key.view;
        let kind = fs::metadata(path).map_err(failed)?;
        if !kind.is_file() {
            return Err(damaged("is no plain file".into()));
        }
        let file = File::open(path).map_err(failed)?;
        let pixel_bytes = u64::from(width) * u64::from(height) * 36;
        let bytes_max = 2 * pixel_bytes + FILE_SPARE;
        let mut bytes = Vec::new();
        BufReader::new(file).take(bytes_max + 1).read_to_end(&mut bytes).map_err(failed)?;

        // The header says what it shows.
        let unreadable = |error: Error| damaged(format!("is not a readable EXR file: {error}"));
        let meta = MetaData::read_from_buffered(bytes.as_slice(), false).map_err(unreadable)?;
        let [header] = meta.headers.as_slice() else {
            return Err(damaged(format!("has {} layers instead of one", meta.headers.len())));
        };
        let Some(AttributeValue::Text(text)) = header.own_attributes.other.get(&Text::from(Self::ATTRIBUTE))
        else {
            return Err(damaged("is no reference of the oracle: it does not say what it shows".into()));
        };
        compare(&text.to_string(), key, path)?;
        let size = header.layer_size;
        if (size.0, size.1) != (width as usize, height as usize) {
            return Err(damaged(format!(
                "holds {} x {} pixels instead of {width} x {height}",
                size.0, size.1
            )));
        }
        if header.channels.list.len() != CHANNELS.len() {
            return Err(damaged(format!("has {} channels instead of 9", header.channels.list.len())));
        }
        if bytes.len() as u64 > bytes_max {
            return Err(damaged(format!("is longer than {bytes_max} bytes, and should not be")));
        }

        let reader = read().no_deep_data().largest_resolution_level().all_channels().first_valid_layer();
        let image = reader
            .all_attributes()
            .non_parallel()
            .from_buffered(std::io::Cursor::new(&bytes))
            .map_err(unreadable)?;
        let image = from_channels(width, height, &image.layer_data.channel_data.list).map_err(damaged)?;
        Ok(Self { key: *key, image })
    }
}

/// Fails with the first setting that differs.
fn compare(text: &str, key: &Key, path: &Path) -> Result<(), ReferenceError> {
    let found: Vec<(&str, &str)> = text.lines().filter_map(|line| line.split_once(": ")).collect();
    for (setting, wanted) in key.settings() {
        let in_file = found.iter().find(|(name, _)| *name == setting).map_or("unknown", |(_, value)| value);
        if in_file != wanted {
            let found = in_file.chars().filter(|c| !c.is_control()).take(200).collect();
            return Err(ReferenceError::Differs { path: path.to_owned(), setting, found, wanted });
        }
    }
    Ok(())
}

/// A picture of its channels, whatever their order.
fn from_channels(
    width: u32,
    height: u32,
    channels: &[AnyChannel<FlatSamples>],
) -> Result<OracleImage, String> {
    let pixels = width as usize * height as usize;
    let mut words: [Vec<u32>; 9] = Default::default();
    for (index, name) in CHANNELS.iter().enumerate() {
        let channel = channels.iter().find(|channel| channel.name.eq(name));
        let channel = channel.ok_or_else(|| format!("has no channel {name}"))?;
        words[index] = match &channel.sample_data {
            FlatSamples::F32(values) if index < 8 => values.iter().map(|value| value.to_bits()).collect(),
            FlatSamples::U32(values) if index == 8 => values.clone(),
            _ => return Err(format!("holds another kind of number in {name}")),
        };
        if words[index].len() != pixels {
            return Err(format!("holds {} numbers in {name} instead of {pixels}", words[index].len()));
        }
        // Depth alone may be infinite.
        let is_fine = |bits: &u32| match index {
            8 => true,
            4 => !f32::from_bits(*bits).is_nan(),
            _ => f32::from_bits(*bits).is_finite(),
        };
        if let Some(at) = words[index].iter().position(|bits| !is_fine(bits)) {
            let (x, y) = (at % width as usize, at / width as usize);
            return Err(format!(
                "holds a value of {name} at column {x}, row {y} that is not a finite number"
            ));
        }
    }
    let rows: Vec<u8> =
        (0..pixels).flat_map(|k| words.iter().flat_map(move |word| word[k].to_le_bytes())).collect();
    OracleImage::from_layers(width, height, &rows).map_err(|error: LayersError| error.to_string())
}
