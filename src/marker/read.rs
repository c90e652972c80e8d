//! Bits → code: the exact match by a sorted table, the nearest by a scan.

use super::{Family, Reading};
use std::sync::OnceLock;

/// Each family's codes turned to the least of their four orientations, sorted, with their ids.
static LEAST: [OnceLock<Vec<(u64, u32)>>; Family::ALL.len()] = [const { OnceLock::new() }; Family::ALL.len()];

impl Family {
    /// Finds the code nearest to bits read row by row from the read quad's first corner; `None` when every
    /// code differs in more than `max_hamming()` bits in each of the four orientations. Mirrored prints are
    /// never tried. Of codes equally near, the first.
    pub fn read(self, bits: u64) -> Option<Reading> {
        let turned = self.orientations(bits);
        let least = turned[0].min(turned[1]).min(turned[2].min(turned[3]));
        let table = LEAST.get(self as usize)?.get_or_init(|| self.sorted());
        if let Ok(place) = table.binary_search_by_key(&least, |&(code, _)| code) {
            let id = table[place].1;
            let code = self.codes()[id as usize];
            let rotation = turned.iter().position(|view| *view == code)?;
            return Some(Reading { id, rotation, hamming: 0 });
        }
        if self.max_hamming() > 0 { self.nearest(&turned) } else { None }
    }

    /// Sorts the family's codes, once, so that no later reading allocates.
    pub fn prepare(self) {
        if let Some(table) = LEAST.get(self as usize) {
            table.get_or_init(|| self.sorted());
        }
    }

    /// The nearest code by trying all.
    fn nearest(self, turned: &[u64; 4]) -> Option<Reading> {
        let mut best: Option<Reading> = None;
        let mut bound = self.max_hamming();
        for (id, code) in (0u32..).zip(self.codes()) {
            for (rotation, view) in turned.iter().enumerate() {
                let hamming = (code ^ view).count_ones();
                if hamming < bound || (hamming == bound && best.is_none()) {
                    best = Some(Reading { id, rotation, hamming });
                    bound = hamming;
                }
            }
        }
        best
    }

    fn sorted(self) -> Vec<(u64, u32)> {
        let least = |&code: &u64| self.orientations(code).into_iter().min().unwrap_or(code);
        let mut table: Vec<(u64, u32)> = self.codes().iter().map(least).zip(0..).collect();
        table.sort_unstable();
        table
    }

    fn orientations(self, bits: u64) -> [u64; 4] {
        let mut turned = [bits; 4];
        for turn in 1..4 {
            turned[turn] = self.turn(turned[turn - 1]);
        }
        turned
    }

    /// The bits as they are read when one starts from the next corner clockwise.
    pub fn turn(self, bits: u64) -> u64 {
        let n = self.inner();
        let mut turned = 0;
        for row in 0..n {
            for column in 0..n {
                let from = column * n + (n - 1 - row);
                turned = (turned << 1) | ((bits >> (n * n - 1 - from)) & 1);
            }
        }
        turned
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::SplitMix64;

    /// Least distance between any two codes in any orientation, a code from its own turns included.
    fn distance(family: Family) -> u32 {
        let codes = family.codes();
        let mut least = u32::MAX;
        for (i, &code) in codes.iter().enumerate() {
            let turned = family.orientations(code);
            for (turn, view) in turned.iter().enumerate() {
                for (j, other) in codes.iter().enumerate().skip(i) {
                    if !(turn == 0 && i == j) {
                        least = least.min((view ^ other).count_ones());
                    }
                }
            }
        }
        least
    }

    /// The distances the families are published with hold over every pair and orientation; so a transcription
    /// error of the tables would show. The bounds follow from them by the rule of `max_hamming`.
    #[test]
    fn codes_keep_their_distance() {
        for (family, count, published) in [
            (Family::Tag36h11, 587, 11),
            (Family::Tag25h9, 35, 9),
            (Family::Tag16h5, 30, 5),
            (Family::Aruco4x4_50, 50, 4),
            (Family::Aruco4x4_100, 100, 3),
            (Family::Aruco4x4_250, 250, 3),
            (Family::Aruco4x4_1000, 1000, 2),
            (Family::Aruco5x5_50, 50, 8),
            (Family::Aruco5x5_100, 100, 7),
            (Family::Aruco5x5_250, 250, 6),
            (Family::Aruco5x5_1000, 1000, 5),
            (Family::Aruco6x6_50, 50, 13),
            (Family::Aruco6x6_100, 100, 12),
            (Family::Aruco6x6_250, 250, 11),
            (Family::Aruco6x6_1000, 1000, 9),
            (Family::Aruco7x7_50, 50, 19),
            (Family::Aruco7x7_100, 100, 18),
            (Family::Aruco7x7_250, 250, 17),
            (Family::Aruco7x7_1000, 1000, 14),
            (Family::ArucoOriginal, 1023, 1),
            (Family::Matrix3x3, 64, 1),
            (Family::Matrix3x3Parity65, 32, 2),
            (Family::Matrix3x3Hamming63, 8, 1),
        ] {
            let codes = family.codes();
            assert_eq!(codes.len(), count);
            let bits = family.inner() * family.inner();
            assert!(codes.iter().all(|code| code >> bits == 0));
            assert!(codes.iter().all(|&code| family.turn(family.orientations(code)[3]) == code));
            assert_eq!(distance(family), published, "{}", family.name());
            let wrong = family.max_hamming();
            assert!(
                2 * wrong < published && (wrong == 0 || family.chance(wrong) <= 5e-4),
                "{}",
                family.name()
            );
        }
    }

    #[test]
    fn every_code_reads_as_itself_in_every_orientation() {
        for family in Family::ALL {
            let bits = family.inner() * family.inner();
            let mut rng = SplitMix64::new(5);
            for (id, &code) in (0u32..).zip(family.codes()) {
                for (turn, view) in family.orientations(code).into_iter().enumerate() {
                    let rotation = (4 - turn) % 4;
                    assert_eq!(family.read(view), Some(Reading { id, rotation, hamming: 0 }));
                    let mut damage = 0u64;
                    while damage.count_ones() < family.max_hamming() {
                        damage |= 1 << (rng.next_u64() % bits as u64);
                    }
                    let hamming = family.max_hamming();
                    assert_eq!(family.read(view ^ damage), Some(Reading { id, rotation, hamming }));
                }
            }
        }
    }

    /// The table finds what the plain scan finds, and random bits pass as often as `chance` says.
    #[test]
    fn random_bits_pass_as_rarely_as_promised() {
        for family in Family::ALL {
            let bits = family.inner() * family.inner();
            let mut rng = SplitMix64::new(family as u64);
            let (cases, mut passed) = (30_000, 0);
            for _ in 0..cases {
                let view = rng.next_u64() >> (64 - bits);
                let reading = family.read(view);
                assert_eq!(reading, family.nearest(&family.orientations(view)));
                passed += usize::from(reading.is_some());
            }
            let expected = family.chance(family.max_hamming()) * cases as f64;
            let off = (passed as f64 - expected).abs();
            assert!(off <= 5.0 * expected.sqrt() + 1.0, "{}: {passed} of {expected}", family.name());
        }
    }

    /// A print seen from behind (or in a mirror) is not that marker, nor oftener any other than random bits are.
    #[test]
    fn mirrored_codes_are_not_read() {
        for family in Family::ALL {
            let n = family.inner();
            let mirrored = |code: u64| {
                let bit = |row: usize, column: usize| (code >> (n * n - 1 - (row * n + n - 1 - column))) & 1;
                (0..n * n).fold(0, |bits, i| (bits << 1) | bit(i / n, i % n))
            };
            let (mut others, codes) = (0, family.codes().len());
            for (id, &code) in (0u32..).zip(family.codes()) {
                let mirror = mirrored(code);
                assert_eq!(mirrored(mirror), code);
                let like = |view: u64| (view ^ code).count_ones() <= family.max_hamming();
                if family.orientations(mirror).into_iter().any(like) {
                    continue;
                }
                let reading = family.read(mirror);
                assert!(reading.is_none_or(|reading| reading.id != id), "{} {id}", family.name());
                others += usize::from(reading.is_some());
            }
            // dense codes are hit as often as random bits hit them, those made of regular rows oftener; of
            // 6x6_1000 two are, with three bits corrected
            let bound = match family.chance(0) {
                _ if family == Family::ArucoOriginal || family.inner() == 3 => codes,
                chance if chance < 1e-3 => 2,
                chance => (2.0 * chance * codes as f64) as usize + 2,
            };
            assert!(others <= bound, "{}: {others}", family.name());
        }
    }
}
