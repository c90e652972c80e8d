//! One channel of pixels: owned (`Plane`) or a strided view (`PlaneRef`, `PlaneMut`).
//!
//! Row y starts at sample `y * stride`; samples past `width` in a row are padding and hold anything.

use super::Size;
use rayon::prelude::*;

/// An owned channel of `width` x `height` samples, rows `stride` samples apart (`stride >= width`).
#[derive(Clone, Debug)]
pub struct Plane<T> {
    data: Vec<T>,
    size: Size,
    stride: usize,
}

impl<T> Default for Plane<T> {
    fn default() -> Self {
        Self { data: Vec::new(), size: Size::new(0, 0), stride: 0 }
    }
}

impl<T: Copy> Plane<T> {
    /// A plane filled with `value`, without padding.
    pub fn new(size: Size, value: T) -> Self {
        Self { data: vec![value; size.area()], size, stride: size.width }
    }

    /// A plane filled with `value` whose rows are `stride` samples apart; a `stride` below the width is
    /// raised to it.
    pub fn with_stride(size: Size, stride: usize, value: T) -> Self {
        let stride = stride.max(size.width);
        Self { data: vec![value; stride * size.height], size, stride }
    }

    /// A plane of the samples `f(x, y)`.
    pub fn from_fn(size: Size, mut f: impl FnMut(usize, usize) -> T) -> Self {
        let data = (0..size.height).flat_map(|y| (0..size.width).map(move |x| (x, y)));
        Self { data: data.map(|(x, y)| f(x, y)).collect(), size, stride: size.width }
    }

    /// Takes unpadded rows, top first; `None` unless there are exactly `size.area()` samples.
    pub fn from_vec(size: Size, data: Vec<T>) -> Option<Self> {
        (data.len() == size.area()).then_some(Self { data, size, stride: size.width })
    }

    /// Gives the plane this size, unpadded, keeping its memory where it suffices. Samples are unspecified
    /// afterwards, unless the size stays the same: then nothing happens. Allocates only to grow.
    pub fn resize(&mut self, size: Size, value: T) {
        if self.size != size {
            self.data.resize(size.area(), value);
            self.size = size;
            self.stride = size.width;
        }
    }

    /// Sets every sample, padding included.
    pub fn fill(&mut self, value: T) {
        self.data.fill(value);
    }

    /// Width and height.
    pub fn size(&self) -> Size {
        self.size
    }

    /// Distance between row starts, in samples.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// The sample at column `x`, row `y`. Panics outside the plane.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> T {
        self.row(y)[x]
    }

    /// The samples of row `y`, padding left out. Panics when `y` is outside.
    #[inline]
    pub fn row(&self, y: usize) -> &[T] {
        &self.data[y * self.stride..][..self.size.width]
    }

    /// The samples of row `y` to write. Panics when `y` is outside.
    #[inline]
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.stride..][..self.size.width]
    }

    /// Rows from the top, padding left out.
    pub fn rows(&self) -> impl ExactSizeIterator<Item = &[T]> {
        let width = self.size.width;
        self.data.chunks(self.stride.max(1)).take(self.size.height).map(move |row| &row[..width])
    }

    /// All samples, padding included.
    pub fn samples(&self) -> &[T] {
        &self.data
    }

    /// All samples to write, padding included.
    pub fn samples_mut(&mut self) -> &mut [T] {
        &mut self.data
    }

    /// A view of the whole plane.
    pub fn view(&self) -> PlaneRef<'_, T> {
        PlaneRef { data: &self.data, size: self.size, stride: self.stride }
    }

    /// A view of the whole plane to write.
    pub fn view_mut(&mut self) -> PlaneMut<'_, T> {
        PlaneMut { data: &mut self.data, size: self.size, stride: self.stride }
    }
}

impl<T: Copy + PartialEq> PartialEq for Plane<T> {
    /// Same size and samples; padding does not count.
    fn eq(&self, other: &Self) -> bool {
        self.size == other.size && self.rows().eq(other.rows())
    }
}

/// A borrowed, possibly strided channel.
#[derive(Clone, Copy, Debug)]
pub struct PlaneRef<'a, T> {
    data: &'a [T],
    size: Size,
    stride: usize,
}

impl<'a, T: Copy> PlaneRef<'a, T> {
    /// Views `data` as rows `stride` samples apart; `None` when it is too short or `stride < width`. The
    /// last row needs no padding.
    pub fn new(data: &'a [T], size: Size, stride: usize) -> Option<Self> {
        fits(data.len(), size, stride).then_some(Self { data, size, stride })
    }

    /// Width and height.
    pub fn size(&self) -> Size {
        self.size
    }

    /// Distance between row starts, in samples.
    pub fn stride(&self) -> usize {
        self.stride
    }

    /// The samples of row `y`. Panics when `y` is outside.
    #[inline]
    pub fn row(&self, y: usize) -> &'a [T] {
        &self.data[y * self.stride..][..self.size.width]
    }

    /// The sample at column `x`, row `y`. Panics outside the view.
    #[inline]
    pub fn at(&self, x: usize, y: usize) -> T {
        self.row(y)[x]
    }

    /// The part `size` large whose first sample is at column `x`, row `y`; `None` when it reaches outside.
    pub fn part(&self, x: usize, y: usize, size: Size) -> Option<Self> {
        let fits =
            |from: usize, len: usize, whole: usize| from.checked_add(len).is_some_and(|to| to <= whole);
        if !(fits(x, size.width, self.size.width) && fits(y, size.height, self.size.height)) {
            return None;
        }
        Self::new(&self.data[(y * self.stride + x).min(self.data.len())..], size, self.stride)
    }

    /// An owned, unpadded copy.
    pub fn to_plane(&self) -> Plane<T> {
        Plane::from_fn(self.size, |x, y| self.at(x, y))
    }
}

/// A borrowed, possibly strided channel to write.
#[derive(Debug)]
pub struct PlaneMut<'a, T> {
    data: &'a mut [T],
    size: Size,
    stride: usize,
}

impl<'a, T: Copy + Send> PlaneMut<'a, T> {
    /// Views `data` as rows `stride` samples apart; `None` when it is too short or `stride < width`. The
    /// last row needs no padding.
    pub fn new(data: &'a mut [T], size: Size, stride: usize) -> Option<Self> {
        fits(data.len(), size, stride).then_some(Self { data, size, stride })
    }

    /// Width and height.
    pub fn size(&self) -> Size {
        self.size
    }

    /// The samples of row `y` to write. Panics when `y` is outside.
    #[inline]
    pub fn row_mut(&mut self, y: usize) -> &mut [T] {
        &mut self.data[y * self.stride..][..self.size.width]
    }

    /// A shorter-lived view of the same samples.
    pub fn reborrow(&mut self) -> PlaneMut<'_, T> {
        PlaneMut { data: self.data, size: self.size, stride: self.stride }
    }

    /// Splits into bands of `rows` rows (the last may be lower), in parallel: `(first row, band)`.
    /// Allocates nothing.
    pub fn par_bands(self, rows: usize) -> impl IndexedParallelIterator<Item = (usize, PlaneMut<'a, T>)> {
        let PlaneMut { data, size, stride } = self;
        let rows = rows.max(1);
        // an empty plane has no samples to split, and a zero chunk length would panic
        let used = if size.area() == 0 { 0 } else { data.len().min(size.height * stride) };
        data[..used].par_chunks_mut((rows * stride).max(1)).enumerate().map(move |(band, data)| {
            let first = band * rows;
            let size = Size::new(size.width, rows.min(size.height - first));
            (first, PlaneMut { data, size, stride })
        })
    }
}

fn fits(len: usize, size: Size, stride: usize) -> bool {
    let needed = match size.height {
        0 => Some(0),
        rows => stride.checked_mul(rows - 1).and_then(|n| n.checked_add(size.width)),
    };
    stride >= size.width && needed.is_some_and(|n| len >= n)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_cover_every_row_once_and_leave_padding() {
        for (w, h, stride, rows) in [(5, 7, 9, 2), (1, 1, 1, 4), (0, 3, 0, 2), (4, 0, 4, 2), (3, 8, 3, 8)] {
            let mut plane = Plane::with_stride(Size::new(w, h), stride, 255u8);
            plane.view_mut().par_bands(rows).for_each(|(first, mut band)| {
                for y in 0..band.size().height {
                    band.row_mut(y).fill((first + y) as u8);
                }
            });
            for y in 0..h {
                assert!(plane.row(y).iter().all(|&v| v == y as u8));
            }
            if stride > w {
                assert_eq!(plane.samples()[w], 255, "padding must stay as it was");
            }
        }
    }

    #[test]
    fn views_refuse_short_buffers() {
        let data = [0u8; 11];
        assert!(PlaneRef::new(&data, Size::new(3, 3), 4).is_some(), "last row unpadded");
        assert!(PlaneRef::new(&data, Size::new(4, 3), 4).is_none());
        assert!(PlaneRef::new(&data, Size::new(3, 3), 2).is_none());
        assert!(PlaneRef::new(&data, Size::new(1, usize::MAX), usize::MAX).is_none());
        assert!(PlaneRef::new(&data[..0], Size::new(0, 0), 0).is_some());
    }
}
