//! How page flips go, and what to do when they do not. Pure: outcomes come in, the next step goes out.
//!
//! A flip whose end is never told may be one that never happened: the mode is set again with the next picture, at the
//! first and then at every tenth (a driver that never tells is slow, not wrong). Flips that are refused as too early are
//! dropped pictures; three in a row set the mode again, five give the card up.

/// Refusals in a row that set the mode again, and that give the card up.
const RESET: u32 = 3;
const REFUSALS: u32 = 5;
/// Late ends in a row from one setting of the mode to the next.
const LATE: u32 = 10;

/// How to show the next picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Next {
    /// By a page flip.
    Flip,
    /// By setting the mode again.
    SetMode,
    /// Not at all: the card takes no more.
    GiveUp,
}

/// What became of the last flips.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Flips {
    late: u32,
    refused: u32,
    lost: u64,
    reset: bool,
}

impl Flips {
    /// A flip's end was told.
    pub(super) fn ended(&mut self) {
        self.late = 0;
    }

    /// It was not, in time.
    pub(super) fn late(&mut self) {
        self.lost += 1;
        self.reset = self.late.is_multiple_of(LATE);
        self.late += 1;
    }

    /// A flip was taken.
    pub(super) fn queued(&mut self) {
        self.refused = 0;
    }

    /// A flip was refused: the last one is not over.
    pub(super) fn refused(&mut self) {
        self.refused += 1;
        self.reset |= self.refused == RESET;
    }

    /// The mode was set again.
    pub(super) fn set(&mut self) {
        self.reset = false;
    }

    /// How to go on.
    pub(super) fn next(&self) -> Next {
        match (self.refused, self.reset) {
            (REFUSALS.., _) => Next::GiveUp,
            (_, true) => Next::SetMode,
            _ => Next::Flip,
        }
    }

    /// Flips whose end was never told, since opening.
    pub(super) fn lost(&self) -> u64 {
        self.lost
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_follows_what() {
        // e: ended, l: late, q: queued, r: refused, s: mode set; then what is next: f, s or g
        let table = [
            ("", "f"),
            ("qe", "f"),
            ("ql", "s"),
            ("qls", "f"),
            ("qlsql", "f"),
            ("qlsqlqlqlqlqlqlqlqlql", "f"),
            ("qlsqlqlqlqlqlqlqlqlqlql", "s"),
            ("qlsqeql", "s"),
            ("rr", "f"),
            ("rrr", "s"),
            ("rrrs", "f"),
            ("rrrsrr", "g"),
            ("rrqrr", "f"),
            ("qlr", "s"),
        ];
        for (story, next) in table {
            let mut flips = Flips::default();
            for event in story.chars() {
                match event {
                    'e' => flips.ended(),
                    'l' => flips.late(),
                    'q' => flips.queued(),
                    'r' => flips.refused(),
                    _ => flips.set(),
                }
            }
            let wanted = match next {
                "f" => Next::Flip,
                "s" => Next::SetMode,
                _ => Next::GiveUp,
            };
            assert_eq!(flips.next(), wanted, "{story}");
            assert_eq!(flips.lost(), story.matches('l').count() as u64);
        }
    }
}
