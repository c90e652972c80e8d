//! Bits → code.
//!
//! Every code is held in its four orientations. Bits that differ from one in at most h places agree with it in at
//! least one of h + 1 parts of the word (pigeonhole), so that only the few codes that share a part are compared.

use super::{Family, Reading};
use std::sync::OnceLock;

/// What a family's codes are found by.
#[derive(Debug)]
struct Index {
    /// Codes in every orientation: bits as read, id, rotation.
    views: Vec<(u64, u32, u32)>,
    /// Bits of a part.
    width: u32,
    /// For every part: where the views with each value of its bits begin in `order`.
    begin: Vec<Vec<u32>>,
    /// For every part: views sorted by the part's bits.
    order: Vec<Vec<u32>>,
}

static INDEX: [OnceLock<Index>; Family::ALL.len()] = [const { OnceLock::new() }; Family::ALL.len()];

/// Most bits of a part: bounds the tables.
const MOST_WIDTH: u32 = 12;

impl Index {
    fn new(family: Family) -> Self {
        let bits = (family.inner() * family.inner()) as u32;
        let parts = family.max_hamming() + 1;
        let width = (bits / parts).min(MOST_WIDTH);
        let mut views = Vec::new();
        for (id, &code) in (0u32..).zip(family.codes()) {
            // the print turned once is read as the code turned once: rotation 3
            for (turn, view) in (0u32..).zip(family.orientations(code)) {
                views.push((view, id, (4 - turn) % 4));
            }
        }
        let (mut begin, mut order) = (Vec::new(), Vec::new());
        for part in 0..parts {
            let value = |i: u32| Self::part(views[i as usize].0, part, width);
            let mut sorted: Vec<u32> = (0..views.len() as u32).collect();
            sorted.sort_by_key(|&i| value(i));
            let first = |bits: usize| sorted.partition_point(|&i| value(i) < bits) as u32;
            begin.push((0..=1usize << width).map(first).collect());
            order.push(sorted);
        }
        Self { views, width, begin, order }
    }

    fn part(bits: u64, part: u32, width: u32) -> usize {
        (bits >> (part * width)) as usize & ((1 << width) - 1)
    }
}

impl Family {
    /// Finds the code nearest to bits read row by row from the read quad's first corner; `None` when every
    /// code differs in more than `max_hamming()` bits in each of the four orientations. Mirrored prints are
    /// never tried. Of codes equally near, the first.
    pub fn read(self, bits: u64) -> Option<Reading> {
        let index = INDEX.get(self as usize)?.get_or_init(|| Index::new(self));
        let mut best: Option<Reading> = None;
        for part in 0..=self.max_hamming() {
            let value = Index::part(bits, part, index.width);
            let (begin, order) = (&index.begin[part as usize], &index.order[part as usize]);
            for &i in &order[begin[value] as usize..begin[value + 1] as usize] {
                let (view, id, rotation) = index.views[i as usize];
                let reading =
                    Reading { id, rotation: rotation as usize, hamming: (view ^ bits).count_ones() };
                let key = |r: &Reading| (r.hamming, r.id, r.rotation);
                if reading.hamming <= self.max_hamming() && best.is_none_or(|best| key(&reading) < key(&best))
                {
                    best = Some(reading);
                }
            }
        }
        best
    }

    /// Builds what [`Family::read`] looks up, once, so that no later reading allocates.
    pub fn prepare(self) {
        if let Some(index) = INDEX.get(self as usize) {
            index.get_or_init(|| Index::new(self));
        }
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
            // a plain square is nobody's code
            assert!(codes.iter().all(|code| (1..(1 << bits) - 1).contains(code)));
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

    /// The nearest code by trying all: the reference.
    fn nearest(family: Family, bits: u64) -> Option<Reading> {
        let turned = family.orientations(bits);
        let tries = (0u32..).zip(family.codes()).flat_map(|(id, code)| {
            (0..4).map(move |rotation| Reading {
                id,
                rotation,
                hamming: (code ^ turned[rotation]).count_ones(),
            })
        });
        tries.filter(|r| r.hamming <= family.max_hamming()).min_by_key(|r| (r.hamming, r.id, r.rotation))
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
                assert_eq!(reading, nearest(family, view));
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
