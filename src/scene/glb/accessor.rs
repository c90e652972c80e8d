//! Accessors: typed values in the binary part (§3.6), read one by one, never past their end.

use super::broken;
use super::json::{Accessor, Document};
use crate::scene::load::Refusal;

/// The binary part and what describes it.
#[derive(Clone, Copy)]
pub(super) struct Buffers<'a> {
    pub document: &'a Document,
    pub data: &'a [u8],
}

impl<'a> Buffers<'a> {
    /// The bytes of a view, and its stride where it has one.
    pub fn view(&self, index: u32) -> Result<(&'a [u8], Option<usize>), Refusal> {
        let view = self.document.buffer_views.get(index as usize);
        let view = view.ok_or_else(|| broken(format_args!("there is no buffer view {index}")))?;
        let outside = self.document.buffers.get(view.buffer as usize).is_none_or(|b| b.uri.is_some());
        if view.buffer != 0 || outside {
            return Err(broken("its data is in another file; save everything in one .glb"));
        }
        let bytes = slice(self.data, view.byte_offset, view.byte_length);
        let bytes = bytes.ok_or_else(|| broken(format_args!("buffer view {index} reaches past the data")))?;
        Ok((bytes, view.byte_stride.map(|stride| usize::try_from(stride).unwrap_or(usize::MAX))))
    }

    /// The accessor number `index`, its values of at least `width` components.
    pub fn read(&self, index: u32, width: usize) -> Result<Reader<'a>, Refusal> {
        let accessor = self.document.accessors.get(index as usize);
        let accessor = accessor.ok_or_else(|| broken(format_args!("there is no accessor {index}")))?;
        let wrong = |what: &str| broken(format_args!("accessor {index}: {what}"));
        let components = match accessor.shape.as_str() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => 0,
        };
        // colors have three or four components, everything else exactly its own
        if components != width && (width, components) != (3, 4) {
            return Err(wrong("not of the type its use asks for"));
        }
        let component = Component::of(accessor).ok_or_else(|| wrong("unknown component type"))?;
        let past = || wrong("reaches past its buffer view");
        let count = u32::try_from(accessor.count).ok().filter(|&count| count < u32::MAX);
        let count = count.ok_or_else(past)? as usize;
        let size = components * component.size();
        let dense = match accessor.buffer_view {
            None => None,
            Some(view) => {
                let (bytes, stride) = self.view(view)?;
                Some(
                    Array::new(bytes, accessor.byte_offset, count, stride.unwrap_or(size), size)
                        .ok_or_else(past)?,
                )
            }
        };
        let sparse = match &accessor.sparse {
            None => None,
            Some(sparse) => {
                let place = Component::unsigned(sparse.indices.component_type);
                let place = place.ok_or_else(|| wrong("unknown type of sparse indices"))?;
                let count = usize::try_from(sparse.count).ok().filter(|&s| s <= count).ok_or_else(past)?;
                let array = |view: u32, offset, size| {
                    Array::new(self.view(view)?.0, offset, count, size, size).ok_or_else(past)
                };
                let indices = array(sparse.indices.buffer_view, sparse.indices.byte_offset, place.size())?;
                let values = array(sparse.values.buffer_view, sparse.values.byte_offset, size)?;
                Some(Sparse { place, indices, values, count })
            }
        };
        Ok(Reader { component, components, count, dense, sparse })
    }
}

fn slice(bytes: &[u8], offset: u64, length: u64) -> Option<&[u8]> {
    let (offset, length) = (usize::try_from(offset).ok()?, usize::try_from(length).ok()?);
    bytes.get(offset..offset.checked_add(length)?)
}

/// Items at even steps in bytes.
struct Array<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
}

impl<'a> Array<'a> {
    /// `None` unless all of `count` items of `size` bytes are inside.
    fn new(bytes: &'a [u8], offset: u64, count: usize, stride: usize, size: usize) -> Option<Self> {
        let bytes = bytes.get(usize::try_from(offset).ok()?..)?;
        let last = count.saturating_sub(1).checked_mul(stride)?.checked_add(size)?;
        (count == 0 || last <= bytes.len()).then_some(Self { bytes, stride, size })
    }

    /// Item `k`, which must be below the count.
    fn at(&self, k: usize) -> &'a [u8] {
        self.bytes.get(k * self.stride..).and_then(|rest| rest.get(..self.size)).unwrap_or_default()
    }
}

#[derive(Clone, Copy)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(accessor: &Accessor) -> Option<Self> {
        match accessor.component_type {
            5120 => Some(Self::I8),
            5122 => Some(Self::I16),
            5126 => Some(Self::F32),
            other => Self::unsigned(other),
        }
    }

    fn unsigned(number: u32) -> Option<Self> {
        match number {
            5121 => Some(Self::U8),
            5123 => Some(Self::U16),
            5125 => Some(Self::U32),
            _ => None,
        }
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }

    /// The component at the start of `bytes`; integers by their full range (§3.11).
    fn value(self, bytes: &[u8]) -> f32 {
        match (self, bytes) {
            (Self::I8, [a, ..]) => (f32::from(*a as i8) / 127.0).max(-1.0),
            (Self::U8, [a, ..]) => f32::from(*a) / 255.0,
            (Self::I16, [a, b, ..]) => (f32::from(i16::from_le_bytes([*a, *b])) / 32767.0).max(-1.0),
            (Self::U16, [a, b, ..]) => f32::from(u16::from_le_bytes([*a, *b])) / 65535.0,
            (Self::F32, [a, b, c, d, ..]) => f32::from_le_bytes([*a, *b, *c, *d]),
            _ => f32::NAN,
        }
    }

    /// The whole number at the start of `bytes`; past every vertex for what is none.
    fn index(self, bytes: &[u8]) -> u32 {
        match (self, bytes) {
            (Self::U8, [a, ..]) => u32::from(*a),
            (Self::U16, [a, b, ..]) => u32::from(u16::from_le_bytes([*a, *b])),
            (Self::U32, [a, b, c, d, ..]) => u32::from_le_bytes([*a, *b, *c, *d]),
            _ => u32::MAX,
        }
    }
}

/// Values that replace some of an accessor's, at rising indices.
struct Sparse<'a> {
    place: Component,
    indices: Array<'a>,
    values: Array<'a>,
    count: usize,
}

impl<'a> Sparse<'a> {
    fn at(&self, wanted: usize) -> Option<&'a [u8]> {
        let (mut low, mut high) = (0, self.count);
        while low < high {
            let middle = low + (high - low) / 2;
            match (self.place.index(self.indices.at(middle)) as usize).cmp(&wanted) {
                std::cmp::Ordering::Less => low = middle + 1,
                std::cmp::Ordering::Greater => high = middle,
                std::cmp::Ordering::Equal => return Some(self.values.at(middle)),
            }
        }
        None
    }
}

/// The values of one accessor; zeros where the file gives none.
pub(super) struct Reader<'a> {
    component: Component,
    components: usize,
    count: usize,
    dense: Option<Array<'a>>,
    sparse: Option<Sparse<'a>>,
}

impl<'a> Reader<'a> {
    /// How many values there are.
    pub fn count(&self) -> usize {
        self.count
    }

    fn bytes(&self, k: usize) -> Option<&'a [u8]> {
        let replaced = self.sparse.as_ref().and_then(|sparse| sparse.at(k));
        replaced.or_else(|| self.dense.as_ref().filter(|_| k < self.count).map(|dense| dense.at(k)))
    }

    /// The first three components of value `k`.
    pub fn value(&self, k: usize) -> [f32; 3] {
        let mut value = [0.0; 3];
        if let Some(bytes) = self.bytes(k) {
            let parts = bytes.chunks(self.component.size());
            for (value, part) in value.iter_mut().zip(parts.take(self.components)) {
                *value = self.component.value(part);
            }
        }
        value
    }

    /// Value `k` as a vertex number.
    pub fn index(&self, k: usize) -> u32 {
        self.bytes(k).map_or(0, |bytes| self.component.index(bytes))
    }
}
