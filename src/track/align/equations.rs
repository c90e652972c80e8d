//! The normal equations of one Gauss-Newton step.
//!
//! Samples go in blocks: first every sample's row of derivatives and its residual, weighted, then the products
//! of all rows. f32 with eight fixed lanes a sum, so that every SIMD level gives the same bits; the lanes are
//! added in f64.

use super::gather::{MOST_SAMPLES, Samples, f32s};
use super::pattern::{Pattern, STRIDE};
use super::{Fit, UNKNOWNS};
use fearless_simd::{Simd, SimdBase, SimdFrom, f32x8, i32x8, prelude::*};

/// Lanes of a sum.
const LANES: usize = 8;
/// Lane groups of a block.
const GROUPS: usize = 4;
/// Rows of a block: the unknowns' derivatives and the residual.
const ROWS: usize = UNKNOWNS + 1;
/// Products of rows two by two, those of a row with itself and the rows before it after those of the row before.
const PRODUCTS: usize = ROWS * (ROWS + 1) / 2;
/// Where those of the residual begin.
const RIGHT: usize = PRODUCTS - ROWS;
/// A·step = b (A's lower triangle), the weighted sum of squared residuals and the sum of weights.
pub struct Sums {
    pub a: [[f64; UNKNOWNS]; UNKNOWNS],
    pub b: [f64; UNKNOWNS],
    pub squares: f64,
    pub weights: f64,
}

type Block = [[[f32; LANES]; GROUPS]; ROWS];

/// The equations at the fit's present place, without A (0) unless `products_too`; `None` where that is degenerate.
#[inline(always)]
pub fn normal<S: Simd>(
    simd: S,
    samples: &Samples,
    pattern: &Pattern,
    fit: &Fit,
    products_too: bool,
) -> Option<Sums> {
    let inverse = fit.map.inverse();
    if !inverse.is_finite() {
        return None;
    }
    let model = Model {
        simd,
        inverse: f32s(&inverse),
        forward: [fit.map.x_axis.z as f32, fit.map.y_axis.z as f32, fit.map.z_axis.z as f32],
        levels: fit.levels.map(|v| v as f32),
        blur: fit.blur.map(|v| v as f32),
        reach: (1.0 / fit.reach) as f32,
        pattern,
    };
    // the widest the kernel is in cells decides how many cells a pixel may see
    let narrow = fit.widest_cells(pattern.cells as f64)? < 0.48;
    let mut products = [[0.0f32; LANES]; PRODUCTS];
    let mut weights = f32x8::splat(simd, 0.0);
    let count = samples.count.min(MOST_SAMPLES);
    let mut block: Block = [[[0.0; LANES]; GROUPS]; ROWS];
    for from in (0..count).step_by(GROUPS * LANES) {
        for g in 0..GROUPS {
            let at = from + g * LANES;
            if at >= count {
                for row in &mut block {
                    row[g] = [0.0; LANES];
                }
            } else if narrow {
                weights += model.rows::<1>(samples, at, count, g, &mut block);
            } else {
                weights += model.rows::<3>(samples, at, count, g, &mut block);
            }
        }
        if products_too {
            let mut k = 0;
            for row in (0..ROWS).step_by(2) {
                accumulate_two(simd, &block, row, &mut products[k..k + 2 * row + 3]);
                k += 2 * row + 3;
            }
        } else {
            accumulate(simd, &block, UNKNOWNS, &mut products[RIGHT..]);
        }
    }
    let total = |lanes: &[f32]| lanes.iter().map(|v| f64::from(*v)).sum::<f64>();
    let mut sums = Sums {
        a: [[0.0; UNKNOWNS]; UNKNOWNS],
        b: [0.0; UNKNOWNS],
        squares: total(&products[RIGHT + UNKNOWNS]),
        weights: total(weights.as_slice()),
    };
    let mut k = 0;
    for row in 0..UNKNOWNS {
        sums.b[row] = total(&products[RIGHT + row]);
        for column in 0..=row {
            sums.a[row][column] = total(&products[k]);
            k += 1;
        }
    }
    Some(sums)
}

/// Adds the products of a row of the block with the rows up to itself.
#[inline(always)]
fn accumulate<S: Simd>(simd: S, block: &Block, row: usize, sums: &mut [[f32; LANES]]) {
    let a0 = f32x8::from_slice(simd, &block[row][0]);
    let a1 = f32x8::from_slice(simd, &block[row][1]);
    let a2 = f32x8::from_slice(simd, &block[row][2]);
    let a3 = f32x8::from_slice(simd, &block[row][3]);
    for (sum, other) in sums.iter_mut().zip(block) {
        let here = (a0 * f32x8::from_slice(simd, &other[0]) + a1 * f32x8::from_slice(simd, &other[1]))
            + (a2 * f32x8::from_slice(simd, &other[2]) + a3 * f32x8::from_slice(simd, &other[3]));
        let here = f32x8::from_slice(simd, &sum[..]) + here;
        sum.copy_from_slice(here.as_slice());
    }
}

/// The same for the row after it as well, its products following: what is read serves both.
#[inline(always)]
fn accumulate_two<S: Simd>(simd: S, block: &Block, row: usize, sums: &mut [[f32; LANES]]) {
    let (first, second) = sums.split_at_mut(row + 1);
    let a0 = f32x8::from_slice(simd, &block[row][0]);
    let a1 = f32x8::from_slice(simd, &block[row][1]);
    let a2 = f32x8::from_slice(simd, &block[row][2]);
    let a3 = f32x8::from_slice(simd, &block[row][3]);
    let b0 = f32x8::from_slice(simd, &block[row + 1][0]);
    let b1 = f32x8::from_slice(simd, &block[row + 1][1]);
    let b2 = f32x8::from_slice(simd, &block[row + 1][2]);
    let b3 = f32x8::from_slice(simd, &block[row + 1][3]);
    for ((one, two), other) in first.iter_mut().zip(second.iter_mut()).zip(block) {
        let c = f32x8::from_slice(simd, &other[0]);
        let (mut a, mut b) = (a0 * c, b0 * c);
        let c = f32x8::from_slice(simd, &other[1]);
        (a, b) = (a + a1 * c, b + b1 * c);
        let c = f32x8::from_slice(simd, &other[2]);
        let (mut a_more, mut b_more) = (a2 * c, b2 * c);
        let c = f32x8::from_slice(simd, &other[3]);
        (a_more, b_more) = (a_more + a3 * c, b_more + b3 * c);
        let here = f32x8::from_slice(simd, &one[..]) + (a + a_more);
        one.copy_from_slice(here.as_slice());
        let here = f32x8::from_slice(simd, &two[..]) + (b + b_more);
        two.copy_from_slice(here.as_slice());
    }
    let here = (b0 * b0 + b1 * b1) + (b2 * b2 + b3 * b3);
    let last = &mut second[row + 1];
    let here = f32x8::from_slice(simd, &last[..]) + here;
    last.copy_from_slice(here.as_slice());
}

/// The fit's numbers as the kernel uses them.
struct Model<'a, S: Simd> {
    simd: S,
    inverse: [[f32; 3]; 3],
    forward: [f32; 3],
    levels: [f32; 6],
    blur: [f32; 3],
    reach: f32,
    pattern: &'a Pattern,
}

/// The blurred boundaries about a place along one axis: how much of what lies past each is seen, and the
/// derivatives by the cell coordinate and by the logarithm of the kernel's width.
struct Steps<S: Simd> {
    value: [f32x8<S>; 3],
    slope: [f32x8<S>; 3],
    by_width: [f32x8<S>; 3],
}

impl<S: Simd> Model<'_, S> {
    /// Steps at the `N` boundaries nearest to a place `d` past the nearest one.
    #[inline(always)]
    fn steps<const N: usize>(&self, d: f32x8<S>, width: f32x8<S>) -> Steps<S> {
        let simd = self.simd;
        let zero = f32x8::splat(simd, 0.0);
        let one = f32x8::splat(simd, 1.0);
        let over = one / width;
        let mut out = Steps { value: [zero; 3], slope: [zero; 3], by_width: [zero; 3] };
        for k in 0..N {
            // boundaries -1, 0, 1 from the nearest
            let d = if N == 1 { d } else { d - (k as f32 - 1.0) };
            let z = (d * over).max(f32x8::splat(simd, -1.0)).min(one);
            let zz = z * z;
            let rest = one - zz;
            let bell = rest * rest * 0.9375;
            out.value[k] = z * (zz * (zz * 0.1875 - 0.625) + 0.9375) + 0.5;
            out.slope[k] = bell * over;
            out.by_width[k] = zero - z * bell;
        }
        out
    }

    /// Derivatives and residuals of the samples at `at..at + LANES`, weighted, into group `g` of the block; the
    /// weights. Lanes past `count` weigh nothing.
    #[inline(always)]
    fn rows<const N: usize>(
        &self,
        samples: &Samples,
        at: usize,
        count: usize,
        g: usize,
        block: &mut Block,
    ) -> f32x8<S> {
        let simd = self.simd;
        let x = f32x8::from_slice(simd, &samples.x[at..at + LANES]);
        let y = f32x8::from_slice(simd, &samples.y[at..at + LANES]);
        let gray = f32x8::from_slice(simd, &samples.gray[at..at + LANES]);
        let one = f32x8::splat(simd, 1.0);
        let m = &self.inverse;
        let over = one / (x * m[0][2] + y * m[1][2] + m[2][2]);
        let px = (x * m[0][0] + y * m[1][0] + m[2][0]) * over;
        let py = (x * m[0][1] + y * m[1][1] + m[2][1]) * over;
        let half = 0.5 * self.pattern.cells as f32;
        let over_half = over * half;
        // gradients of the cell coordinates
        let ux = (px * -m[0][2] + m[0][0]) * over_half;
        let uy = (px * -m[1][2] + m[1][0]) * over_half;
        let vx = (py * m[0][2] - m[0][1]) * over_half;
        let vy = (py * m[1][2] - m[1][1]) * over_half;
        let (least, most) = (f32x8::splat(simd, 1e-3), f32x8::splat(simd, 1.5));
        let [xx, xy, yy] = self.blur;
        // the kernel's extent along either axis of cells
        let wide_u = (ux * ux * xx + ux * uy * (2.0 * xy) + uy * uy * yy).sqrt().max(least).min(most);
        let wide_v = (vx * vx * xx + vx * vy * (2.0 * xy) + vy * vy * yy).sqrt().max(least).min(most);
        let (u, v) = (px * half + half, half - py * half);
        let (first, last) = (f32x8::splat(simd, 0.0), f32x8::splat(simd, self.pattern.cells as f32));
        let bu = (u + 0.5).floor().max(first).min(last);
        let bv = (v + 0.5).floor().max(first).min(last);
        let place: i32x8<S> = (bv * STRIDE as f32 + bu).to_int();
        let mut codes = [0i32; LANES];
        for (code, &at) in codes.iter_mut().zip(place.as_slice()) {
            *code = i32::from(self.pattern.around[at as usize % (STRIDE * STRIDE)]);
        }
        let code = i32x8::simd_from(simd, codes);
        let across = self.steps::<N>(u - bu, wide_u);
        let down = self.steps::<N>(v - bv, wide_v);

        // each row of cells blurred across, then the rows blurred down
        let zero = f32x8::splat(simd, 0.0);
        let mut value = zero;
        let (mut by_u, mut by_v) = (zero, zero);
        // by the logarithms of the extents
        let (mut by_wide_u, mut by_wide_v) = (zero, zero);
        let mut above = (zero, zero, zero);
        for j in 0..=N {
            let (mut line, mut slope, mut wide) = (zero, zero, zero);
            let mut before = zero;
            for i in 0..=N {
                let k = if N == 1 { (j + 1) * 4 + i + 1 } else { j * 4 + i };
                let bit = code & i32x8::splat(simd, 1 << k);
                let ink = bit.simd_gt(0).select(one, zero);
                if i == 0 {
                    line = ink;
                } else {
                    let step = ink - before;
                    line += step * across.value[i - 1];
                    slope += step * across.slope[i - 1];
                    wide += step * across.by_width[i - 1];
                }
                before = ink;
            }
            if j == 0 {
                (value, by_u, by_wide_u) = (line, slope, wide);
            } else {
                let step = line - above.0;
                value += step * down.value[j - 1];
                by_v += step * down.slope[j - 1];
                by_u += (slope - above.1) * down.value[j - 1];
                by_wide_u += (wide - above.2) * down.value[j - 1];
                by_wide_v += step * down.by_width[j - 1];
            }
            above = (line, slope, wide);
        }

        let l = &self.levels;
        let black = px * l[1] + py * l[2] + l[0];
        let step = px * l[4] + py * l[5] + l[3];
        let miss = gray - black - step * value;
        // Geman-McClure: full weight near, none far; the root of the weight goes on the rows
        let far = miss * self.reach;
        let mut root = one / (far * far + 1.0);
        if at + LANES > count {
            let mut mask = [0.0; LANES];
            mask[..count - at].fill(1.0);
            root *= f32x8::simd_from(simd, mask);
        }
        let contrast = step * root;
        // moving the pattern by d changes the pixel by -step · gradient · d
        let w = px * self.forward[0] + py * self.forward[1] + self.forward[2];
        let pull = zero - contrast / w;
        let gx = (ux * by_u + vx * by_v) * pull;
        let gy = (uy * by_u + vy * by_v) * pull;
        let inward = zero - (gx * x + gy * y);
        let seen = value * root;
        // the blur's unknowns are in parts of the blur, so that A changes little as it does
        let wider = contrast * (0.5 * (xx + yy));
        let (fu, fv) = (by_wide_u / (wide_u * wide_u), by_wide_v / (wide_v * wide_v));
        let rows = [
            gx * px,
            gx * py,
            gx,
            gy * px,
            gy * py,
            gy,
            inward * px,
            inward * py,
            root,
            root * px,
            root * py,
            seen,
            seen * px,
            seen * py,
            (fu * ux * ux + fv * vx * vx) * wider * 0.5,
            (fu * ux * uy + fv * vx * vy) * wider,
            (fu * uy * uy + fv * vy * vy) * wider * 0.5,
            miss * root,
        ];
        for (row, out) in rows.iter().zip(block.iter_mut()) {
            out[g].copy_from_slice(row.as_slice());
        }
        root * root
    }
}
