//! What can be wrong, by codes that do not change: a page for each is in `board/FAULTS.md`.

use std::sync::atomic::{AtomicU8, Ordering};

/// Something that is wrong and may get right by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Fault {
    /// The camera cannot be opened or left.
    CameraGone = 1,
    /// The camera is open and sends no pictures.
    CameraSilent = 2,
}

impl Fault {
    /// All.
    pub const ALL: [Self; 2] = [Self::CameraGone, Self::CameraSilent];

    /// Its code.
    pub const fn code(self) -> &'static str {
        match self {
            Self::CameraGone => "C1",
            Self::CameraSilent => "C2",
        }
    }

    /// What a visitor reads, and the line below it.
    pub const fn says(self) -> [&'static str; 2] {
        match self {
            Self::CameraGone => ["CAMERA LOST", "C1 - looking for it"],
            Self::CameraSilent => ["NO PICTURE", "C2 - waiting for the camera"],
        }
    }
}

/// The camera's present fault, shared between its thread and the one that shows.
#[derive(Debug, Default)]
pub struct Present(AtomicU8);

impl Present {
    /// Something is wrong, or nothing any more.
    pub fn set(&self, fault: Option<Fault>) {
        self.0.store(fault.map_or(0, |fault| fault as u8), Ordering::Relaxed);
    }

    /// What is wrong.
    pub fn get(&self) -> Option<Fault> {
        let number = self.0.load(Ordering::Relaxed);
        Fault::ALL.into_iter().find(|fault| *fault as u8 == number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fault_has_a_code_and_a_page() {
        let pages = include_str!("../../board/FAULTS.md");
        for fault in Fault::ALL {
            assert!(pages.contains(&format!("\n## {} ", fault.code())), "{fault:?}");
            assert!(fault.says()[1].starts_with(fault.code()));
            let present = Present::default();
            assert_eq!(present.get(), None);
            present.set(Some(fault));
            assert_eq!(present.get(), Some(fault));
        }
    }
}
