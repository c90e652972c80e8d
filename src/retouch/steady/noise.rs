//! How noisy the camera is: robust, from a sample of the picture, slowly followed.
//!
//! Two medians are taken and the smaller believed: of the second differences along rows, which texture makes too
//! large, and of the differences from the frame before, which motion makes too large.

use crate::pixels::{Plane, Size};

/// Every fourth pixel of every fourth row is looked at.
const STEP: usize = 4;
/// The median of |x| of a standard normal x.
const MEDIAN: f64 = 0.674_489_750_196_081_7;
/// Share of a new measurement, a frame.
const PACE: f64 = 0.1;

/// The measured noise.
#[derive(Debug, Default)]
pub struct Noise {
    sigma: Option<f64>,
    /// The sample of the frame before.
    before: Vec<u8>,
    size: Option<Size>,
}

impl Noise {
    /// Standard deviation in levels; 0 before anything was measured.
    pub fn sigma(&self) -> f64 {
        self.sigma.unwrap_or(0.0)
    }

    /// Looks at the next picture's green. Pictures under 3 pixels wide say nothing. Allocates only when the size
    /// changes.
    pub fn measure(&mut self, green: &Plane<u8>) {
        let size = green.size();
        if size.width < 3 || size.height == 0 {
            return;
        }
        let known = self.size == Some(size);
        let count = size.height.div_ceil(STEP) * (size.width - 2).div_ceil(STEP);
        self.before.resize(count, 0);
        let (mut along, mut across) = ([0u32; 256], [0u32; 256]);
        let mut before = self.before.iter_mut();
        for y in (0..size.height).step_by(STEP) {
            let row = green.row(y);
            for (taps, before) in row.windows(3).step_by(STEP).zip(&mut before) {
                let [left, here, right] = [taps[0], taps[1], taps[2]].map(i32::from);
                along[(left - 2 * here + right).unsigned_abs().min(255) as usize] += 1;
                across[usize::from(taps[1].abs_diff(*before))] += 1;
                *before = taps[1];
            }
        }
        // variances of the differences: 1 + 4 + 1 and 1 + 1 times the noise's
        let mut sigma = median(&along) / (MEDIAN * 6f64.sqrt());
        if known {
            sigma = sigma.min(median(&across) / (MEDIAN * 2f64.sqrt()));
        }
        self.size = Some(size);
        let last = self.sigma.filter(|_| known).unwrap_or(sigma);
        self.sigma = Some(last + (sigma - last) * PACE);
    }
}

/// The median of absolute differences, each spread over half a level to either side.
fn median(counts: &[u32; 256]) -> f64 {
    let half = f64::from(counts.iter().sum::<u32>()) / 2.0;
    let mut below = 0.0;
    for (value, &count) in counts.iter().enumerate() {
        let count = f64::from(count);
        if below + count >= half && count > 0.0 {
            let share = (half - below) / count;
            return if value == 0 { share / 2.0 } else { value as f64 - 0.5 + share };
        }
        below += count;
    }
    255.0
}
