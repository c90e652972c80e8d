//! ARToolKit's picture markers: `.patt` files and how a seen patch is recognized among them.
//!
//! A `.patt` file is text: four blocks, the picture as seen from each corner of the print clockwise from the
//! upright's top-left, each three channels (blue, green, red) of 16 x 16 numbers 0..255. A patch is compared as
//! ARToolKit does in its mono mode (arPattGetID.c, pattern_match): mean removed, normalized correlation with
//! every block, the best decides picture and orientation.

use super::Reading;
use crate::pixels::{Plane, Size};
use std::io::Read;
use std::path::{Path, PathBuf};

/// Samples along a side of the picture.
const SIDE: usize = 16;
/// Numbers in a file.
const NUMBERS: usize = 4 * 3 * SIDE * SIDE;
/// Largest file that is read: three digits and a space a number would be 12 kB.
const MOST_BYTES: u64 = 1 << 16;
/// Most patterns of a scene: each costs 4 x 256 multiplications for every black square seen.
const MOST: usize = 64;
/// Correlation of two pictures (or of a picture with itself turned) from which a camera cannot tell them apart.
const ALIKE: f64 = 0.9;
/// Least lead of the best correlation over any other picture or orientation.
const LEAST_LEAD: f64 = 0.1;
/// Least deviation of a patch, of the step from black to white: an empty square has no picture.
const LEAST_DEVIATION: f64 = 0.06;

/// A seen picture, row by row: 0 = the border's black, 1 = the paper's white.
pub type Patch = [f64; SIDE * SIDE];

/// The picture markers of a scene; a picture's number is its place here.
#[derive(Clone, Debug, Default)]
pub struct Patterns {
    known: Vec<Pattern>,
}

#[derive(Clone, Debug)]
struct Pattern {
    path: PathBuf,
    least_match: f64,
    /// Mean 0, length 1; as seen from each corner.
    views: [Patch; 4],
    /// The upright gray picture, 0..1.
    gray: Patch,
}

/// Why a `.patt` file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PatternError {
    /// The file cannot be read.
    #[error("{}: cannot read the pattern: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is no pattern.
    #[error("{}: not a pattern of ARToolKit: {reason}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// What is wrong in it.
        reason: String,
    },
    /// The pattern cannot be told from another, or its upright from its other orientations.
    #[error("{}: {reason}", path.display())]
    Alike {
        /// The file.
        path: PathBuf,
        /// What it is like.
        reason: String,
    },
    /// `least_match` is out of range.
    #[error(
        "least_match = {0}: give a correlation from 0.5 (finds more) to 0.95 (is surer); 0.7 if left out"
    )]
    Match(f64),
    /// There are too many patterns.
    #[error("more than {MOST} patterns: use a family with codes for many markers")]
    Many,
}

impl Patterns {
    /// Correlation asked for when none is said. ARToolKit asks for 0.5; a patch of 16 x 16 smooth samples has
    /// only some ten degrees of freedom, so that much happens by chance in one of a hundred.
    pub const LEAST_MATCH: f64 = 0.7;

    /// Loads a `.patt` file and returns its number; a file that is already known keeps the one it has, with the
    /// larger `least_match` (0.5..=0.95).
    pub fn load(&mut self, path: &Path, least_match: f64) -> Result<u32, PatternError> {
        if !(0.5..=0.95).contains(&least_match) {
            return Err(PatternError::Match(least_match));
        }
        if let Some((id, known)) = (0u32..).zip(&mut self.known).find(|(_, known)| known.path == path) {
            known.least_match = known.least_match.max(least_match);
            return Ok(id);
        }
        let read = |source| PatternError::Read { path: path.into(), source };
        let mut text = Vec::new();
        let file = std::fs::File::open(path).map_err(read)?;
        file.take(MOST_BYTES + 1).read_to_end(&mut text).map_err(read)?;
        self.add(&text, path, least_match)
    }

    fn add(&mut self, text: &[u8], path: &Path, least_match: f64) -> Result<u32, PatternError> {
        let wrong = |reason| PatternError::Wrong { path: path.into(), reason };
        let alike = |reason| PatternError::Alike { path: path.into(), reason };
        let (views, gray) = parse(text).map_err(wrong)?;
        if self.known.len() == MOST {
            return Err(PatternError::Many);
        }
        let turned = (1..4).map(|turn| dot(&views[0], &views[turn])).fold(-1.0, f64::max);
        if turned > ALIKE {
            return Err(alike(format!(
                "the picture is like itself turned (correlation {turned:.2}): its upright cannot be told"
            )));
        }
        for known in &self.known {
            let nearest = known.views.iter().map(|view| dot(&views[0], view)).fold(-1.0, f64::max);
            if nearest > ALIKE {
                let other = known.path.display();
                return Err(alike(format!("the picture is like {other} (correlation {nearest:.2})")));
            }
        }
        self.known.push(Pattern { path: path.into(), least_match, views, gray });
        Ok(self.known.len() as u32 - 1)
    }

    /// How many there are.
    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// The upright print of a pattern in gray, 40 samples a side: 4 of white quiet zone and 8 of black border
    /// around the picture's 16. `None` when there is no such pattern.
    pub fn print(&self, id: u32) -> Option<Plane<u8>> {
        let gray = &self.known.get(id as usize)?.gray;
        let inside = |v: usize, border: usize| (border..40 - border).contains(&v);
        Some(Plane::from_fn(Size::new(40, 40), |x, y| {
            if inside(x, 12) && inside(y, 12) {
                (255.0 * gray[(y - 12) * SIDE + x - 12] + 0.5) as u8
            } else {
                255 * u8::from(!(inside(x, 4) && inside(y, 4)))
            }
        }))
    }

    /// The pattern that a patch, read from the quad's first corner, shows best, and its correlation -1..=1.
    /// `None` when the patch is flat, no pattern reaches its `least_match`, or another (or the same turned) is
    /// about as near.
    pub fn recognize(&self, patch: &Patch) -> Option<(Reading, f64)> {
        let view = normalized(patch, LEAST_DEVIATION)?;
        let (mut best, mut second) = ((f64::NEG_INFINITY, 0, 0), f64::NEG_INFINITY);
        for (id, known) in (0u32..).zip(&self.known) {
            for (corner, picture) in known.views.iter().enumerate() {
                let likeness = dot(&view, picture);
                if likeness > best.0 {
                    second = best.0;
                    best = (likeness, id, corner);
                } else {
                    second = second.max(likeness);
                }
            }
        }
        let (likeness, id, corner) = best;
        let known = self.known.get(id as usize)?;
        let sure = likeness >= known.least_match && likeness - second >= LEAST_LEAD;
        // the first corner is the print's corner number `corner`
        sure.then_some((Reading { id, rotation: (4 - corner) % 4, hamming: 0 }, likeness))
    }
}

/// The four gray views and the upright picture.
fn parse(text: &[u8]) -> Result<([Patch; 4], Patch), String> {
    if text.len() as u64 > MOST_BYTES {
        return Err(format!("larger than {} kB", MOST_BYTES >> 10));
    }
    let text = std::str::from_utf8(text).map_err(|e| format!("byte {} is no text", e.valid_up_to()))?;
    let mut numbers = [0u8; NUMBERS];
    let mut count = 0;
    for (line, words) in (1..).zip(text.lines()) {
        for word in words.split_ascii_whitespace() {
            let place = numbers.get_mut(count).ok_or(format!("line {line}: more than {NUMBERS} numbers"))?;
            let short: String = word.chars().take(20).collect();
            *place = word.parse().map_err(|_| format!("line {line}: `{short}` is no number 0..255"))?;
            count += 1;
        }
    }
    if count != NUMBERS {
        return Err(format!("{count} numbers, {NUMBERS} are needed (4 views x 3 channels x 16 x 16)"));
    }
    let mut views = [[0.0; SIDE * SIDE]; 4];
    let mut gray = views;
    for ((view, gray), block) in views.iter_mut().zip(&mut gray).zip(numbers.chunks_exact(3 * SIDE * SIDE)) {
        for (i, gray) in gray.iter_mut().enumerate() {
            // the camera's luma (BT.601) of blue, green, red
            let [blue, green, red] = [0, 1, 2].map(|channel| f64::from(block[channel * SIDE * SIDE + i]));
            *gray = (0.114 * blue + 0.587 * green + 0.299 * red) / 255.0;
        }
        *view = normalized(gray, 0.02).ok_or("a view has no picture: all its numbers are about the same")?;
    }
    // view k must be view 0 from the next corner on: column 15 - k becomes row k
    let mut seen = gray[0];
    for (turn, view) in views.iter().enumerate().skip(1) {
        let from = seen;
        for (i, value) in seen.iter_mut().enumerate() {
            *value = from[(i % SIDE) * SIDE + SIDE - 1 - i / SIDE];
        }
        let likeness = normalized(&seen, 0.0).map_or(0.0, |seen| dot(&seen, view));
        if likeness < 0.8 {
            return Err(format!(
                "view {} is not the first one turned {}° to the left (correlation {likeness:.2})",
                turn + 1,
                90 * turn
            ));
        }
    }
    Ok((views, gray[0]))
}

/// Mean 0, length 1; `None` when the standard deviation is not above `least`.
fn normalized(patch: &Patch, least: f64) -> Option<Patch> {
    let count = patch.len() as f64;
    let mean = patch.iter().sum::<f64>() / count;
    let mut out = patch.map(|v| v - mean);
    let length = dot(&out, &out).sqrt();
    if !(length > least * count.sqrt() && length.is_finite()) {
        return None;
    }
    for v in &mut out {
        *v /= length;
    }
    Some(out)
}

fn dot(a: &Patch, b: &Patch) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::SplitMix64;

    /// A letter-like picture: blocks of a few gray levels, no symmetry.
    fn picture(seed: u64) -> [u8; SIDE * SIDE] {
        let mut rng = SplitMix64::new(seed);
        let blocks: [u8; 25] = std::array::from_fn(|_| (rng.next_u64() % 4 * 70) as u8);
        std::array::from_fn(|i| blocks[i / SIDE * 5 / SIDE * 5 + i % SIDE * 5 / SIDE])
    }

    fn turned(picture: &[u8; SIDE * SIDE]) -> [u8; SIDE * SIDE] {
        std::array::from_fn(|i| picture[(i % SIDE) * SIDE + SIDE - 1 - i / SIDE])
    }

    fn text(picture: &[u8; SIDE * SIDE]) -> String {
        let mut text = String::new();
        let mut view = *picture;
        for _ in 0..4 {
            for _ in 0..3 {
                for row in view.chunks(SIDE) {
                    let words: Vec<String> = row.iter().map(|v| format!("{v:3}")).collect();
                    text += &(words.join(" ") + "\n");
                }
            }
            text += "\n";
            view = turned(&view);
        }
        text
    }

    fn patch(picture: &[u8; SIDE * SIDE]) -> Patch {
        picture.map(|v| f64::from(v) / 255.0)
    }

    #[test]
    fn a_picture_is_recognized_in_each_orientation_through_noise() {
        let mut patterns = Patterns::default();
        for seed in 0..8 {
            let name = format!("{seed}.patt");
            let id = patterns.add(text(&picture(seed)).as_bytes(), Path::new(&name), 0.7);
            assert_eq!(id.expect("a pattern"), seed as u32);
        }
        let mut rng = SplitMix64::new(1);
        for seed in 0..8u32 {
            let mut view = picture(u64::from(seed));
            let print = patterns.print(seed).expect("a print");
            assert_eq!([print.at(3, 20), print.at(4, 20), print.at(12, 12)], [255, 0, view[0]]);
            for corner in 0..4 {
                let noisy = patch(&view).map(|v| 0.2 + 0.3 * v + 0.2 * (rng.f64() - 0.5));
                let (reading, likeness) = patterns.recognize(&noisy).expect("recognized");
                assert_eq!((reading.id, reading.rotation), (seed, (4 - corner) % 4));
                assert!(likeness > 0.8, "{likeness}");
                view = turned(&view);
            }
            let mirrored: Patch =
                std::array::from_fn(|i| f64::from(view[i / SIDE * SIDE + SIDE - 1 - i % SIDE]));
            assert!(patterns.recognize(&mirrored).is_none());
        }
        assert!(patterns.recognize(&[0.5; SIDE * SIDE]).is_none());
        assert!(patterns.recognize(&[f64::NAN; SIDE * SIDE]).is_none());
    }

    /// Random pictures of 25 blocks are taken for one of eight less than once in 500.
    #[test]
    fn other_pictures_are_refused() {
        let mut patterns = Patterns::default();
        for seed in 0..8 {
            let name = format!("{seed}.patt");
            patterns.add(text(&picture(seed)).as_bytes(), Path::new(&name), 0.7).expect("a pattern");
        }
        let taken = (100..5100).filter(|&seed| patterns.recognize(&patch(&picture(seed))).is_some()).count();
        assert!(taken <= 10, "{taken} of 5000");
    }

    #[test]
    fn what_cannot_be_told_apart_is_answered() {
        let mut patterns = Patterns::default();
        let first = text(&picture(3));
        patterns.add(first.as_bytes(), Path::new("one.patt"), 0.7).expect("a pattern");
        let again =
            patterns.add(first.as_bytes(), Path::new("two.patt"), 0.7).expect_err("the same").to_string();
        assert!(again.contains("two.patt") && again.contains("one.patt"), "{again}");
        let round: [u8; SIDE * SIDE] = std::array::from_fn(|i| {
            let away = |v: usize| (2 * v as i32 - 15).pow(2);
            if away(i / SIDE) + away(i % SIDE) < 80 { 0 } else { 255 }
        });
        let round = patterns.add(text(&round).as_bytes(), Path::new("o.patt"), 0.7).expect_err("a disk");
        assert!(round.to_string().contains("upright"), "{round}");
        let flat =
            patterns.add(text(&[7; SIDE * SIDE]).as_bytes(), Path::new("f.patt"), 0.7).expect_err("flat");
        assert!(flat.to_string().contains("no picture"), "{flat}");
        let missing = patterns.load(Path::new("no/such.patt"), 0.7).expect_err("no file").to_string();
        assert!(missing.starts_with("no/such.patt: "), "{missing}");
        for least_match in [0.49, 0.96, f64::NAN] {
            let error = patterns.load(Path::new("no/such.patt"), least_match).expect_err("out of range");
            assert!(error.to_string().starts_with("least_match = "), "{error}");
        }
        assert_eq!(patterns.len(), 1);
    }

    /// Files cut anywhere or with random bytes changed give a pattern or an error that names the file.
    #[test]
    fn broken_files_are_survived() {
        let whole = text(&picture(4)).into_bytes();
        let try_it = |bytes: &[u8]| {
            let result = Patterns::default().add(bytes, Path::new("x.patt"), 0.7);
            result.map_err(|e| assert!(e.to_string().starts_with("x.patt: "), "{e}")).is_ok()
        };
        assert!(try_it(&whole));
        let end = whole.iter().rposition(u8::is_ascii_digit).expect("digits");
        for cut in 0..end {
            // only the last number may lose digits unseen
            assert!(!try_it(&whole[..cut]) || cut + 2 >= end, "{cut}");
        }
        let mut rng = SplitMix64::new(2);
        for _ in 0..3000 {
            let mut bytes = whole.clone();
            for _ in 0..1 + rng.next_u64() % 4 {
                let place = rng.next_u64() as usize % bytes.len();
                bytes[place] = rng.next_u64() as u8;
            }
            try_it(&bytes);
        }
        assert!(!try_it(&vec![b' '; MOST_BYTES as usize + 1]));
        assert!(!try_it(&[whole.as_slice(), b" 1"].concat()));
    }
}
