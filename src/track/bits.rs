//! From the gray values at a code's cells (-1 = black, 1 = white, as its rings show them) to its bits: as they are,
//! sharpened against their neighbors, or restored from the blur.

/// Most bits along a side.
pub const MOST_BITS: usize = 7;

/// Gray values row by row.
pub type Soft = [[f64; MOST_BITS]; MOST_BITS];

/// Shares of a cell's neighbors on either side in what is seen at its center: a normal blur of .5, .65 and .8 of its width.
pub const SHARES: [f64; 3] = [0.15, 0.2, 0.25];

/// The bits whose blurred print is what is seen: `share` of either neighbor, along rows and along columns. Landweber's
/// iteration within the inks' range.
pub fn restored(soft: &Soft, inner: usize, share: f64) -> u64 {
    // the rings are blurred too: of black and white ink they show this much
    let (middle, half) = (0.5 * share, 1.0 - 2.5 * share);
    // with the border around
    const SIDE: usize = MOST_BITS + 2;
    let mut ink = [[-1.0f64; SIDE]; SIDE];
    let seen = |row: usize, column: usize| (middle + half * soft[row][column]).clamp(-1.0, 1.0);
    for row in 0..inner {
        for column in 0..inner {
            ink[row + 1][column + 1] = seen(row, column);
        }
    }
    for _ in 0..ROUNDS {
        let mut across = [[0.0; SIDE]; SIDE];
        for (out, ink) in across.iter_mut().zip(&ink) {
            for column in 1..=inner {
                out[column] = (1.0 - 2.0 * share) * ink[column] + share * (ink[column - 1] + ink[column + 1]);
            }
        }
        for row in 1..=inner {
            for column in 1..=inner {
                let blurred = (1.0 - 2.0 * share) * across[row][column]
                    + share * (across[row - 1][column] + across[row + 1][column]);
                let miss = seen(row - 1, column - 1) - blurred;
                ink[row][column] = (ink[row][column] + 1.5 * miss).clamp(-1.0, 1.0);
            }
        }
    }
    let mut bits = 0;
    for line in &ink[1..=inner] {
        for v in &line[1..=inner] {
            bits = (bits << 1) | u64::from(*v > 0.0);
        }
    }
    bits
}

/// Rounds of the restoration.
const ROUNDS: usize = 12;

/// Bits row by row, and the mean distance of the values from their threshold (each at most 1).
pub fn harden(soft: &Soft, inner: usize, sharpen: f64) -> (u64, f64) {
    let (mut bits, mut clarity) = (0u64, 0.0);
    let value = |row: usize, column: usize| soft[row][column];
    for row in 0..inner {
        for column in 0..inner {
            // outside the bits lies the black border
            let mut beside = 0.0;
            beside += if row > 0 { value(row - 1, column) } else { -1.0 };
            beside += if column > 0 { value(row, column - 1) } else { -1.0 };
            beside += if row + 1 < inner { value(row + 1, column) } else { -1.0 };
            beside += if column + 1 < inner { value(row, column + 1) } else { -1.0 };
            let v = value(row, column) + sharpen * (4.0 * value(row, column) - beside);
            bits = (bits << 1) | u64::from(v > 0.0);
            clarity += v.abs().min(1.0);
        }
    }
    (bits, clarity / (inner * inner) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::marker::Family;

    /// Every code, blurred as the restoration has it, is restored, though most are not what its cells show.
    #[test]
    fn what_is_restored_is_what_was_blurred() {
        let family = Family::Tag36h11;
        let inner = family.inner();
        for share in SHARES {
            let (mut plain, mut right) = (0, 0);
            for &code in family.codes() {
                let bit = |row: isize, column: isize| {
                    let inside = (0..inner as isize).contains(&row) && (0..inner as isize).contains(&column);
                    let at =
                        inner * inner - 1 - (row * inner as isize + column).max(0) as usize % (inner * inner);
                    if inside && code >> at & 1 == 1 { 1.0 } else { -1.0 }
                };
                let across = |row, column| {
                    (1.0 - 2.0 * share) * bit(row, column)
                        + share * (bit(row, column - 1) + bit(row, column + 1))
                };
                let mut soft = [[0.0; MOST_BITS]; MOST_BITS];
                for (row, line) in (0..).zip(&mut soft[..inner]) {
                    for (column, value) in (0..).zip(&mut line[..inner]) {
                        let seen = (1.0 - 2.0 * share) * across(row, column)
                            + share * (across(row - 1, column) + across(row + 1, column));
                        // from inks to what the blurred rings call black and white
                        *value = (seen - 0.5 * share) / (1.0 - 2.5 * share);
                    }
                }
                plain += usize::from(harden(&soft, inner, 0.0).0 == code);
                right += usize::from(restored(&soft, inner, share) == code);
            }
            let all = family.codes().len();
            // where three quarters of the light are the neighbors' the rounds there are do not end with every code
            let least = if share < 0.25 { all } else { all * 4 / 5 };
            assert!(right >= least && plain < all / 2, "{share}: {plain} plain, {right} restored of {all}");
        }
    }
}
