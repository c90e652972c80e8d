//! Mask → connected dark blobs with their bounding boxes.
//!
//! Rows of bits become runs; a run joins the runs it touches in the row above (4-neighbors), labels are kept
//! by union-find with the oldest label as the root, so that a blob's `start` is its topmost-leftmost pixel.
//! Blobs that cannot be a marker's border are left out at once.

use super::threshold::Mask;
use crate::pixels::Size;

/// A connected set of dark pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Blob {
    /// Its topmost row's leftmost pixel.
    pub start: [u16; 2],
    /// Least x and y.
    pub low: [u16; 2],
    /// Greatest x and y.
    pub high: [u16; 2],
    /// Number of pixels.
    pub area: u32,
}

impl Blob {
    /// Width and height of the bounding box, px.
    pub fn extent(&self) -> [u32; 2] {
        [0, 1].map(|axis| u32::from(self.high[axis] - self.low[axis]) + 1)
    }
}

#[derive(Clone, Copy, Debug)]
struct Run {
    start: u16,
    end: u16,
    label: u32,
}

/// The labeling stage with its buffers.
#[derive(Debug, Default)]
pub struct Segment {
    above: Vec<Run>,
    row: Vec<Run>,
    parent: Vec<u32>,
    blobs: Vec<Blob>,
    kept: Vec<Blob>,
}

impl Segment {
    /// Room for a picture full of things.
    pub fn reserve(&mut self, size: Size) {
        let (row, blobs) = (size.width / 2 + 1, size.area() / 64);
        for runs in [&mut self.above, &mut self.row] {
            runs.clear();
            runs.reserve(row);
        }
        self.parent.clear();
        self.parent.reserve(blobs);
        self.blobs.clear();
        self.blobs.reserve(blobs);
        self.kept.clear();
        self.kept.reserve(blobs / 4);
    }

    /// The blobs whose larger extent is at least `least_px` and which stay clear of the picture's border,
    /// in the order of their starts (rows first). Allocates only when a picture holds more than any before.
    pub fn blobs(&mut self, mask: &Mask, least_px: u32) -> &[Blob] {
        let size = mask.size();
        self.parent.clear();
        self.blobs.clear();
        self.above.clear();
        for y in 0..size.height {
            self.row.clear();
            runs(mask.row(y), size.width, &mut self.row);
            self.join(y as u16);
            std::mem::swap(&mut self.above, &mut self.row);
        }
        let (right, bottom) = (size.width.max(1) - 1, size.height.max(1) - 1);
        self.kept.clear();
        for (label, blob) in self.blobs.iter().enumerate() {
            let [w, h] = blob.extent();
            let inside = blob.low[0] > 0
                && blob.low[1] > 0
                && usize::from(blob.high[0]) < right
                && usize::from(blob.high[1]) < bottom;
            // the border alone of the thinnest marker has more dark pixels than this
            let solid = blob.area >= w + h;
            if self.parent[label] == label as u32 && inside && w.max(h) >= least_px && w.min(h) >= 4 && solid
            {
                self.kept.push(*blob);
            }
        }
        &self.kept
    }

    /// Labels this row's runs from those of the row above.
    fn join(&mut self, y: u16) {
        let mut first = 0;
        for run in &mut self.row {
            while first < self.above.len() && self.above[first].end <= run.start {
                first += 1;
            }
            let mut label = u32::MAX;
            let mut k = first;
            while k < self.above.len() && self.above[k].start < run.end {
                let root = find(&mut self.parent, self.above[k].label);
                if label == u32::MAX {
                    label = root;
                } else if root != label {
                    let (old, young) = (label.min(root), label.max(root));
                    self.parent[young as usize] = old;
                    let gone = self.blobs[young as usize];
                    let blob = &mut self.blobs[old as usize];
                    for axis in 0..2 {
                        blob.low[axis] = blob.low[axis].min(gone.low[axis]);
                        blob.high[axis] = blob.high[axis].max(gone.high[axis]);
                    }
                    blob.area += gone.area;
                    label = old;
                }
                k += 1;
            }
            let (last, area) = (run.end - 1, u32::from(run.end - run.start));
            if label == u32::MAX {
                label = self.parent.len() as u32;
                self.parent.push(label);
                self.blobs.push(Blob { start: [run.start, y], low: [run.start, y], high: [last, y], area });
            } else {
                let blob = &mut self.blobs[label as usize];
                blob.low[0] = blob.low[0].min(run.start);
                blob.high = [blob.high[0].max(last), y];
                blob.area += area;
            }
            run.label = label;
        }
    }
}

fn find(parent: &mut [u32], mut label: u32) -> u32 {
    while parent[label as usize] != label {
        // halve the path
        let up = parent[parent[label as usize] as usize];
        parent[label as usize] = up;
        label = up;
    }
    label
}

/// The runs of set bits in a row, left to right.
fn runs(words: &[u64], width: usize, out: &mut Vec<Run>) {
    let mut open: Option<u16> = None;
    let mut before = 0;
    for (i, &word) in words.iter().enumerate() {
        let mut turns = word ^ ((word << 1) | before);
        before = word >> 63;
        while turns != 0 {
            let x = (i * 64) as u16 + turns.trailing_zeros() as u16;
            turns &= turns - 1;
            match open.take() {
                None => open = Some(x),
                Some(start) => out.push(Run { start, end: x, label: 0 }),
            }
        }
    }
    if let Some(start) = open {
        out.push(Run { start, end: width as u16, label: 0 });
    }
}
