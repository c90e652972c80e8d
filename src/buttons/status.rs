//! What the line is told about the visor.

/// Markers a status holds: more do not fit a line.
const MARKERS: usize = 12;

/// How the visor is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// All is well.
    #[default]
    Run,
    /// It runs with less than was asked for.
    Degraded,
    /// No pictures come.
    NoCamera,
    /// No screen.
    NoDisplay,
    /// Dark until a press.
    Standby,
}

impl Mode {
    /// As on the wire.
    pub fn name(self) -> &'static str {
        match self {
            Mode::Run => "RUN",
            Mode::Degraded => "DEGRADED",
            Mode::NoCamera => "NOCAM",
            Mode::NoDisplay => "NODISP",
            Mode::Standby => "STANDBY",
        }
    }
}

/// What is told about the visor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Status {
    /// How it is.
    pub mode: Mode,
    /// Tenths of frames shown a second.
    pub fps10: u32,
    /// Style in front.
    pub style: &'static str,
    /// Bits 0-7: a bit a fault.
    pub faults: u32,
    /// Markers tracked.
    pub markers: Markers,
}

/// Up to twelve markers: id and quality 0-99.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Markers {
    list: [(u32, u8); MARKERS],
    count: usize,
}

impl FromIterator<(u32, u8)> for Markers {
    /// Those past the twelfth are left out.
    fn from_iter<I: IntoIterator<Item = (u32, u8)>>(markers: I) -> Self {
        let mut own = Self::default();
        for (slot, marker) in own.list.iter_mut().zip(markers) {
            *slot = marker;
            own.count += 1;
        }
        own
    }
}

impl std::ops::Deref for Markers {
    type Target = [(u32, u8)];

    fn deref(&self) -> &[(u32, u8)] {
        &self.list[..self.count]
    }
}
