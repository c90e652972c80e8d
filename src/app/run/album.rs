//! Snapshots: off unless `[snapshot]` names a folder. The frame loop copies a picture into a buffer that is free; a
//! thread writes it as a PNG, whole or not at all.

use super::tally::Tally;
use crate::app::config::SnapshotConfig;
use crate::app::fault::Fault;
use crate::pixels::{Rgb, Size, picture};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

/// Pictures that may wait to be written.
const WAITING: usize = 2;

/// The frame loop's end.
pub struct Album {
    desk: Option<Desk>,
    thread: Option<JoinHandle<()>>,
    wanted: bool,
}

struct Desk {
    free: Receiver<Rgb>,
    full: SyncSender<(u64, Rgb)>,
}

impl Album {
    /// An album in the folder that the settings name, for pictures of `size`; without one it takes nothing.
    pub fn open(config: Option<&SnapshotConfig>, size: Size, tally: Arc<Tally>) -> std::io::Result<Self> {
        let Some(SnapshotConfig { dir }) = config.cloned() else {
            return Ok(Self { desk: None, thread: None, wanted: false });
        };
        let (back, free) = sync_channel(WAITING);
        let (full, waiting) = sync_channel::<(u64, Rgb)>(WAITING);
        for _ in 0..WAITING {
            // a new queue has room for all
            let _ = back.try_send(Rgb::new(size, [0; 3]));
        }
        let write = move || {
            for (sequence, picture) in waiting {
                match keep(&dir, sequence, &picture) {
                    Ok(path) => {
                        log::info!("snapshot: {}", path.display());
                        tally.snapshots.add(1);
                        tally.faults.clear(Fault::Snapshot);
                    }
                    Err(error) => {
                        log::warn!("{}: snapshot: {error}", Fault::Snapshot.code());
                        tally.faults.raise(Fault::Snapshot);
                    }
                }
                let _ = back.try_send(picture);
            }
        };
        let thread = std::thread::Builder::new().name("snapshots".into()).spawn(write)?;
        Ok(Self { desk: Some(Desk { free, full }), thread: Some(thread), wanted: false })
    }

    /// Wishes the next picture kept; `false` where nothing is ever kept.
    pub fn want(&mut self) -> bool {
        self.wanted = self.desk.is_some();
        self.wanted
    }

    /// The next picture: copied, if it is wanted; `Some(false)`: all buffers wait to be written. Allocates only when
    /// pictures grow.
    pub fn picture(&mut self, sequence: u64, canvas: &Rgb) -> Option<bool> {
        if !std::mem::take(&mut self.wanted) {
            return None;
        }
        let desk = self.desk.as_ref()?;
        let Ok(mut copy) = desk.free.try_recv() else { return Some(false) };
        copy.resize(canvas.size());
        copy.copy_from(canvas);
        Some(desk.full.try_send((sequence, copy)).is_ok())
    }
}

impl Drop for Album {
    fn drop(&mut self) {
        self.desk = None;
        if let Some(thread) = self.thread.take() {
            // it writes what waits; a panic there has been reported
            let _ = thread.join();
        }
    }
}

/// Writes one picture: `SECONDS-SEQUENCE.png`, seconds since 1970.
fn keep(folder: &Path, sequence: u64, canvas: &Rgb) -> Result<PathBuf, String> {
    let seconds = std::time::UNIX_EPOCH.elapsed().map_or(0, |since| since.as_secs());
    let path = folder.join(format!("{seconds}-{sequence}.png"));
    let beside = folder.join(".writing.png");
    std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()))?;
    picture::write_png(&beside, canvas).map_err(|e| e.to_string())?;
    std::fs::rename(&beside, &path).map_err(|e| format!("{}: {e}", path.display()))?;
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_wished_is_kept_and_nothing_else() {
        let folder = std::env::temp_dir().join(format!("vernissage-album-{}", std::process::id()));
        let (size, tally) = (Size::new(20, 10), Arc::<Tally>::default());
        let picture_of = |gray: u8| Rgb::new(size, [gray; 3]);
        let config = SnapshotConfig { dir: folder.clone() };
        let mut album = Album::open(Some(&config), size, tally.clone()).expect("a thread");
        assert_eq!(album.picture(1, &picture_of(1)), None);
        assert!(album.want());
        assert_eq!(album.picture(2, &picture_of(2)), Some(true));
        assert_eq!(album.picture(3, &picture_of(3)), None);
        drop(album);
        let files: Vec<_> = std::fs::read_dir(&folder).expect("made").flatten().map(|f| f.path()).collect();
        assert_eq!((files.len(), tally.snapshots.get()), (1, 1));
        assert!(files[0].to_string_lossy().ends_with("-2.png"));
        assert_eq!(picture::read(&files[0]).expect("a picture"), picture_of(2));
        std::fs::remove_dir_all(&folder).expect("its own folder");

        let mut none = Album::open(None, size, tally.clone()).expect("no thread");
        assert!(!none.want() && none.picture(1, &picture_of(1)).is_none());
        // a folder that cannot be: the fault says so
        let config = SnapshotConfig { dir: "/proc/none".into() };
        let mut album = Album::open(Some(&config), size, tally.clone()).expect("a thread");
        assert!(album.want());
        assert_eq!(album.picture(1, &picture_of(1)), Some(true));
        drop(album);
        assert!(tally.faults.has(Fault::Snapshot));
    }
}
