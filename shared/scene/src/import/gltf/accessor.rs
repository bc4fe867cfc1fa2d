//! Accessors: typed views into buffers, every bound checked before a byte is read.

use super::json::{self, Root};
use super::{checked, get};
use crate::import::limits::ZERO_FILLED_MAX;
use json::accessor::{ComponentType, Type};

/// The buffers of a file; `None` where it has no bytes (a fallback for an extension that we lack).
pub(super) type Buffers = [Option<Vec<u8>>];

/// An accessor whose bounds have been checked.
pub(super) struct Accessor<'a> {
    /// First element, then one every `stride` bytes; `None`: all zeros.
    data: Option<&'a [u8]>,
    stride: usize,
    size: usize,
    component: ComponentType,
    lanes: usize,
    normalized: bool,
    count: usize,
    /// Elements that replace others: ascending indices, values packed.
    sparse: Option<(Vec<u32>, &'a [u8])>,
}

impl<'a> Accessor<'a> {
    /// Opens `accessors[index]`. The error is a sentence without its subject's file.
    pub(super) fn open(root: &Root, buffers: &'a Buffers, index: usize) -> Result<Self, String> {
        let source = get(&root.accessors, index, "accessors")?;
        let of = |what: String| format!("accessors[{index}] {what}");
        let component = checked(&source.component_type).map_err(of)?.0;
        let type_ = *checked(&source.type_).map_err(of)?;
        let lanes = match type_ {
            Type::Scalar => 1,
            Type::Vec2 => 2,
            Type::Vec3 => 3,
            Type::Vec4 => 4,
            Type::Mat2 | Type::Mat3 | Type::Mat4 => {
                return Err(of("is a matrix where vectors are expected".to_owned()));
            }
        };
        let size = lanes * component_size(component);
        let count =
            usize::try_from(source.count.0).map_err(|_| of(format!("claims {} elements", source.count.0)))?;
        let offset = source.byte_offset.unwrap_or_default().0;
        let (data, stride) = match source.buffer_view {
            Some(view) => {
                let (bytes, stride) = view_bytes(root, buffers, view.value()).map_err(of)?;
                let stride = stride.unwrap_or(size);
                if stride < size {
                    return Err(of(format!("has elements of {size} bytes every {stride} bytes")));
                }
                (Some(part(bytes, offset, count, stride, size).map_err(of)?), stride)
            }
            None if count as u64 > ZERO_FILLED_MAX => {
                return Err(of(format!(
                    "claims {count} zeros without a buffer, more than {ZERO_FILLED_MAX}"
                )));
            }
            None => (None, size),
        };
        let sparse = match &source.sparse {
            Some(sparse) => Some(open_sparse(root, buffers, sparse, count, size).map_err(of)?),
            None if data.is_none() => {
                return Err(of("has neither a bufferView nor a sparse part".to_owned()));
            }
            None => None,
        };
        Ok(Self { data, stride, size, component, lanes, normalized: source.normalized, count, sparse })
    }

    /// Elements.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Numbers an element.
    pub(super) fn lanes(&self) -> usize {
        self.lanes
    }

    /// Whether elements are single unsigned integers.
    pub(super) fn is_index(&self) -> bool {
        let is_unsigned =
            matches!(self.component, ComponentType::U8 | ComponentType::U16 | ComponentType::U32);
        self.lanes == 1 && is_unsigned && !self.normalized
    }

    /// Whether the numbers are floats, or integers that stand for fractions.
    pub(super) fn is_float_or_normalized(&self) -> bool {
        self.component == ComponentType::F32 || self.normalized
    }

    /// The bytes of element `i < count`, `None` for zeros.
    fn element(&self, i: usize) -> Option<&'a [u8]> {
        if let Some((indices, values)) = &self.sparse
            && let Ok(at) = indices.binary_search_by(|&index| (index as usize).cmp(&i))
        {
            return Some(&values[at * self.size..][..self.size]);
        }
        self.data.map(|data| &data[i * self.stride..][..self.size])
    }

    /// Element `i < count` as an index; meant for accessors that [`Accessor::is_index`].
    pub(super) fn index(&self, i: usize) -> u32 {
        match self.element(i) {
            Some(&[a]) => u32::from(a),
            Some(&[a, b]) => u32::from(u16::from_le_bytes([a, b])),
            Some(&[a, b, c, d]) => u32::from_le_bytes([a, b, c, d]),
            _ => 0,
        }
    }

    /// The first `N` numbers of element `i < count`; lanes that the accessor lacks are `fill`.
    pub(super) fn vector<const N: usize>(&self, i: usize, fill: f32) -> [f32; N] {
        let Some(bytes) = self.element(i) else {
            return std::array::from_fn(|lane| if lane < self.lanes { 0.0 } else { fill });
        };
        let width = component_size(self.component);
        let mut lanes = bytes.chunks_exact(width);
        std::array::from_fn(|_| lanes.next().map_or(fill, |lane| self.number(lane)))
    }

    /// A component; normalised ones as in the standard's section 3.11.
    fn number(&self, bytes: &[u8]) -> f32 {
        let (value, largest) = match (self.component, bytes) {
            (ComponentType::I8, &[a]) => (f32::from(a.cast_signed()), 127.0),
            (ComponentType::U8, &[a]) => (f32::from(a), 255.0),
            (ComponentType::I16, &[a, b]) => (f32::from(i16::from_le_bytes([a, b])), 32_767.0),
            (ComponentType::U16, &[a, b]) => (f32::from(u16::from_le_bytes([a, b])), 65_535.0),
            (ComponentType::U32, &[a, b, c, d]) => (u32::from_le_bytes([a, b, c, d]) as f32, u32::MAX as f32),
            (ComponentType::F32, &[a, b, c, d]) => return f32::from_le_bytes([a, b, c, d]),
            _ => return 0.0,
        };
        // Signed numbers have one value below -1.
        if self.normalized { (value / largest).max(-1.0) } else { value }
    }
}

fn component_size(component: ComponentType) -> usize {
    match component {
        ComponentType::I8 | ComponentType::U8 => 1,
        ComponentType::I16 | ComponentType::U16 => 2,
        ComponentType::U32 | ComponentType::F32 => 4,
    }
}

/// The bytes of `bufferViews[index]`, and its stride.
pub(super) fn view_bytes<'a>(
    root: &Root,
    buffers: &'a Buffers,
    index: usize,
) -> Result<(&'a [u8], Option<usize>), String> {
    let view = get(&root.buffer_views, index, "bufferViews")?;
    let buffer = get(buffers, view.buffer.value(), "buffers")?
        .as_ref()
        .ok_or_else(|| format!("needs buffers[{}], which has no uri", view.buffer.value()))?;
    let offset = view.byte_offset.unwrap_or_default().0;
    let bytes = offset
        .checked_add(view.byte_length.0)
        .and_then(|end| buffer.get(usize::try_from(offset).ok()?..usize::try_from(end).ok()?))
        .ok_or_else(|| {
            format!(
                "needs bufferViews[{index}]: bytes {offset} + {} of buffers[{}], which has {}",
                view.byte_length.0,
                view.buffer.value(),
                buffer.len()
            )
        })?;
    Ok((bytes, view.byte_stride.as_ref().map(|stride| stride.0)))
}

/// The bytes from `offset` on that hold `count` elements of `size` bytes, one every `stride`.
fn part(bytes: &[u8], offset: u64, count: usize, stride: usize, size: usize) -> Result<&[u8], String> {
    let length = match count.checked_sub(1) {
        Some(steps) => steps.checked_mul(stride).and_then(|last| last.checked_add(size)),
        None => Some(0),
    };
    length
        .zip(usize::try_from(offset).ok())
        .and_then(|(length, offset)| bytes.get(offset..offset.checked_add(length)?))
        .ok_or_else(|| {
            format!(
                "claims {count} elements of {size} bytes every {stride} from byte {offset} on, but its view has {} bytes",
                bytes.len()
            )
        })
}

fn open_sparse<'a>(
    root: &Root,
    buffers: &'a Buffers,
    sparse: &json::accessor::sparse::Sparse,
    base_count: usize,
    size: usize,
) -> Result<(Vec<u32>, &'a [u8]), String> {
    let of = |what: String| format!("(sparse) {what}");
    let count = usize::try_from(sparse.count.0)
        .ok()
        .filter(|&count| count <= base_count)
        .ok_or_else(|| of(format!("replaces {} of {base_count} elements", sparse.count.0)))?;
    let width = component_size(checked(&sparse.indices.component_type).map_err(of)?.0);
    let (bytes, _) = view_bytes(root, buffers, sparse.indices.buffer_view.value()).map_err(of)?;
    let bytes = part(bytes, sparse.indices.byte_offset.0, count, width, width).map_err(of)?;
    let indices: Vec<u32> = bytes
        .chunks_exact(width)
        .map(|index| index.iter().rev().fold(0, |value, &byte| value << 8 | u32::from(byte)))
        .collect();
    if !indices.is_sorted_by(|a, b| a < b) || indices.last().is_some_and(|&last| last as usize >= base_count)
    {
        return Err(of(format!("has indices that do not ascend or are not below {base_count}")));
    }
    let (bytes, _) = view_bytes(root, buffers, sparse.values.buffer_view.value()).map_err(of)?;
    Ok((indices, part(bytes, sparse.values.byte_offset.0, count, size, size).map_err(of)?))
}
