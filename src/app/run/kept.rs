//! The settings that were good last, kept in the state directory: a visor whose settings file was cut short by a power
//! cut, or lost, starts with them.
//!
//! Two files take turns, each with a generation number and a checksum in its first line: while one is written the other
//! one is whole, so that a cut at any moment leaves the old settings or the new ones. Written only when the settings
//! changed: a visor that runs writes nothing. Only the settings file itself is kept, not the models and scenes it names.

use std::fs::File;
use std::io::Write;
use std::path::{Path, PathBuf};

/// No settings file is longer.
const LONGEST: u64 = 1 << 20;
const CHECKSUM: crc::Crc<u32> = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
const MARK: &str = "# vernissage settings ";

/// Where settings are kept.
#[derive(Clone, Debug)]
pub struct Kept(PathBuf);

impl Kept {
    /// In the service manager's state directory; `None` where there is none.
    pub fn open() -> Option<Self> {
        let folder = std::env::var_os("STATE_DIRECTORY").filter(|folder| !folder.is_empty())?;
        Some(Self(folder.into()))
    }

    fn file(&self, generation: u64) -> PathBuf {
        self.0.join(format!("settings.{}", generation % 2))
    }

    /// The newest settings that are whole, and their generation.
    fn newest(&self) -> Option<(u64, String)> {
        (0..2).filter_map(|which| read(&self.file(which))).max_by_key(|(generation, _)| *generation)
    }

    /// The settings that were good last.
    pub fn text(&self) -> Option<String> {
        self.newest().map(|(_, text)| text)
    }

    /// Keeps these, on the disk when it returns; whether they are others than before. What was kept before stays beside.
    pub fn keep(&self, text: &str) -> std::io::Result<bool> {
        let before = self.newest();
        if before.as_ref().is_some_and(|(_, before)| before == text) || text.len() as u64 > LONGEST {
            return Ok(false);
        }
        let generation = before.map_or(0, |(generation, _)| generation + 1);
        let mut file = File::create(self.file(generation))?;
        file.write_all(whole(generation, text).as_bytes())?;
        file.sync_all()?;
        // a new file's name is the folder's
        File::open(&self.0)?.sync_all()?;
        Ok(true)
    }
}

/// A file's contents.
fn whole(generation: u64, text: &str) -> String {
    let body = format!("{generation}\n{text}");
    format!("{MARK}{:08x} {body}", CHECKSUM.checksum(body.as_bytes()))
}

/// Generation and settings of a file; `None` unless it is there and whole.
fn read(path: &Path) -> Option<(u64, String)> {
    if std::fs::metadata(path).ok()?.len() > LONGEST + 64 {
        return None;
    }
    let text = std::fs::read_to_string(path).ok()?;
    let (sum, body) = text.strip_prefix(MARK)?.split_once(' ')?;
    if u32::from_str_radix(sum, 16).ok()? != CHECKSUM.checksum(body.as_bytes()) {
        return None;
    }
    let (generation, text) = body.split_once('\n')?;
    Some((generation.parse().ok()?, text.into()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every way that a write can be cut short leaves the old settings or the new ones.
    #[test]
    fn a_write_cut_anywhere_leaves_the_old_or_the_new() {
        let folder = std::env::temp_dir().join(format!("vernissage-kept-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let kept = Kept(folder.clone());
        assert_eq!(kept.text(), None);
        let texts: Vec<String> =
            (0..4).map(|n| format!("threads = {n}\n# {}\n", "x".repeat(90 * n))).collect();
        for (n, text) in texts.iter().enumerate() {
            assert!(kept.keep(text).expect("written") && !kept.keep(text).expect("known"), "once");
            assert_eq!(kept.text().as_ref(), Some(text));
            let path = kept.file(n as u64);
            let good = std::fs::read(&path).expect("whole");
            let older = n.checked_sub(1).map(|n| &texts[n]);
            // cut short, and the rest of it zeros or what was there before, as file systems leave it
            for cut in 0..good.len() {
                for rest in [0, good.len() - cut] {
                    let torn = [&good[..cut], &vec![0; rest][..]].concat();
                    std::fs::write(&path, torn).expect("torn");
                    assert_eq!(kept.text().as_ref(), older, "cut at {cut} of {n}");
                }
            }
            std::fs::remove_file(&path).expect("lost");
            assert_eq!(kept.text().as_ref(), older);
            std::fs::write(&path, &good).expect("whole again");
        }
        // what nobody kept is nothing
        for junk in ["", MARK, "# vernissage settings 0 0\n", "threads = 1\n"] {
            (0..2).for_each(|which| std::fs::write(kept.file(which), junk).expect("junk"));
            assert_eq!(kept.text(), None);
        }
        assert!(kept.keep(&texts[1]).expect("written"));
        assert_eq!(kept.text().as_ref(), Some(&texts[1]));
        std::fs::remove_dir_all(&folder).expect("its own folder");
    }
}
