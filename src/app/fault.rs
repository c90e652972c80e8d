//! What can be wrong, by codes that do not change: a page for each is in `board/FAULTS.md`.

use std::sync::atomic::{AtomicU32, AtomicU64, Ordering};

/// Something that is wrong and may get right by itself. The number is its bit on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Fault {
    /// The camera cannot be opened, or it left.
    CameraGone = 0,
    /// The camera is open and sends no pictures.
    CameraSilent = 1,
    /// Another program has the camera.
    CameraBusy = 2,
    /// The screen is unplugged or takes no pictures.
    ScreenGone = 3,
    /// Another program has the screen.
    ScreenOwned = 4,
    /// The settings file was changed and is wrong; the old settings stay.
    Settings = 5,
    /// A snapshot could not be written.
    Snapshot = 6,
    /// Frames cost more than their budget even in the simplest way.
    Slow = 7,
    /// Buttons' own: the port is away, or nobody answers on it.
    ButtonsGone = 9,
}

impl Fault {
    /// All.
    pub const ALL: [Self; 9] = [
        Self::CameraGone,
        Self::CameraSilent,
        Self::CameraBusy,
        Self::ScreenGone,
        Self::ScreenOwned,
        Self::Settings,
        Self::Snapshot,
        Self::Slow,
        Self::ButtonsGone,
    ];

    /// Its code.
    pub const fn code(self) -> &'static str {
        match self {
            Self::CameraGone => "C1",
            Self::CameraSilent => "C2",
            Self::CameraBusy => "C3",
            Self::ScreenGone => "D1",
            Self::ScreenOwned => "D2",
            Self::Settings => "S1",
            Self::Snapshot => "S2",
            Self::Slow => "G1",
            Self::ButtonsGone => "B1",
        }
    }

    /// What a visitor reads, and the line below it; only for what takes the picture away.
    pub const fn says(self) -> Option<[&'static str; 2]> {
        match self {
            Self::CameraGone => Some(["CAMERA LOST", "C1 - looking for it"]),
            Self::CameraSilent => Some(["NO PICTURE", "C2 - waiting for the camera"]),
            Self::CameraBusy => Some(["CAMERA IN USE", "C3 - waiting for it"]),
            _ => None,
        }
    }

    const fn bit(self) -> u32 {
        1 << self as u8
    }
}

/// The faults that are there now, and how often each came. Shared: the threads that see a fault raise it, the frame
/// loop and the reporters read.
#[derive(Debug, Default)]
pub struct Faults {
    present: AtomicU32,
    counts: [AtomicU64; 10],
}

impl Faults {
    /// The fault is there; counted when it was not there before, and `true` then.
    pub fn raise(&self, fault: Fault) -> bool {
        let new = self.present.fetch_or(fault.bit(), Ordering::Relaxed) & fault.bit() == 0;
        if new {
            self.counts[fault as usize].fetch_add(1, Ordering::Relaxed);
        }
        new
    }

    /// The fault is gone; whether it was there.
    pub fn clear(&self, fault: Fault) -> bool {
        self.present.fetch_and(!fault.bit(), Ordering::Relaxed) & fault.bit() != 0
    }

    /// Of these one after the other, this one only, or none.
    pub fn only(&self, group: &[Fault], fault: Option<Fault>) {
        for &other in group {
            match Some(other) == fault {
                true => self.raise(other),
                false => self.clear(other),
            };
        }
    }

    /// Whether it is there.
    pub fn has(&self, fault: Fault) -> bool {
        self.mask() & fault.bit() != 0
    }

    /// A bit each fault that is there.
    pub fn mask(&self) -> u32 {
        self.present.load(Ordering::Relaxed)
    }

    /// How often it came.
    pub fn count(&self, fault: Fault) -> u64 {
        self.counts[fault as usize].load(Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_has_a_code_and_a_page() {
        let pages = include_str!("../../board/FAULTS.md");
        let faults = Faults::default();
        for fault in Fault::ALL {
            assert!(pages.contains(&format!("\n## {} ", fault.code())), "{fault:?}");
            assert!(fault.says().is_none_or(|lines| lines[1].starts_with(fault.code())));
            assert!(faults.raise(fault) && !faults.raise(fault) && faults.has(fault));
            assert_eq!((faults.count(fault), faults.mask()), (1, 1 << fault as u8));
            assert!(faults.clear(fault) && !faults.clear(fault) && !faults.has(fault));
            assert!(faults.raise(fault));
            assert_eq!(faults.count(fault), 2, "it came again");
            faults.clear(fault);
        }
    }

    #[test]
    fn one_of_a_group_at_a_time() {
        let (faults, group) = (Faults::default(), [Fault::CameraGone, Fault::CameraSilent]);
        faults.raise(Fault::Slow);
        faults.only(&group, Some(Fault::CameraSilent));
        faults.only(&group, Some(Fault::CameraGone));
        assert!(faults.has(Fault::CameraGone) && !faults.has(Fault::CameraSilent) && faults.has(Fault::Slow));
        faults.only(&group, None);
        assert_eq!((faults.mask(), faults.count(Fault::CameraSilent)), (1 << Fault::Slow as u8, 1));
    }
}
