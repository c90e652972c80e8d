//! The floors of the house: a room imports only rooms on lower floors, never upward, never sideways.

use std::path::{Path, PathBuf};

/// Each room and its floor, as in `src/lib.rs`.
const FLOORS: &[(&str, u32)] = &[
    ("pixels", 0),
    ("kernel", 1),
    ("geometry", 1),
    ("marker", 2),
    ("calibration", 2),
    ("frame", 3),
    ("scene", 3),
    ("render", 4),
    ("retouch", 4),
    ("camera", 5),
    ("track", 5),
    ("style", 5),
    ("display", 5),
    ("buttons", 5),
    ("pipeline", 6),
    ("app", 7),
];

fn floor(room: &str) -> Option<u32> {
    FLOORS.iter().find(|(name, _)| *name == room).map(|(_, floor)| *floor)
}

fn sources(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("source folder") {
        let path = entry.expect("folder entry").path();
        if path.is_dir() {
            sources(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// The rooms named after `crate::` in one file, `use crate::{a::.., b::..}` included.
fn imports(text: &str) -> Vec<String> {
    let code: String =
        text.lines().map(|line| line.split("//").next().unwrap_or("")).collect::<Vec<_>>().join("\n");
    let word = |s: &str| s.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
    let mut rooms = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        match rest.strip_prefix('{') {
            None => rooms.push(word(rest)),
            Some(group) => {
                let mut depth = 0;
                let mut start = true;
                for (i, c) in group.char_indices() {
                    match c {
                        '{' => depth += 1,
                        '}' if depth == 0 => break,
                        '}' => depth -= 1,
                        ',' if depth == 0 => start = true,
                        c if start && c.is_alphabetic() => {
                            rooms.push(word(&group[i..]));
                            start = false;
                        }
                        _ => {}
                    }
                }
            }
        }
    }
    rooms
}

#[test]
fn rooms_import_only_lower_floors() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut checked = 0;
    for file in &files {
        let inside = file.strip_prefix(&root).expect("under src");
        let room =
            inside.iter().next().expect("a name").to_string_lossy().trim_end_matches(".rs").to_string();
        let Some(own) = floor(&room) else {
            assert!(["lib", "main"].contains(&room.as_str()), "{room} is on no floor: add it to FLOORS");
            continue;
        };
        for import in imports(&std::fs::read_to_string(file).expect("readable source")) {
            let Some(other) = floor(&import) else { continue };
            assert!(
                import == room || other < own,
                "{} (floor {own}) imports {import} (floor {other}): move what is shared down",
                inside.display()
            );
            checked += 1;
        }
    }
    assert!(checked > 20, "only {checked} imports seen: does the parser still understand the sources?");
}

#[test]
fn grouped_imports_are_understood() {
    let text = "use crate::{app::x, pixels::{self, Plane}};\nuse crate::kernel::a; // crate::nothing";
    assert_eq!(imports(text), ["app", "pixels", "kernel"]);
}

#[test]
fn unsafe_is_allowed_in_two_files_only() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    sources(&root, &mut files);
    let mut allowed: Vec<String> = files
        .iter()
        .filter(|f| std::fs::read_to_string(f).expect("readable source").contains("allow(unsafe_code)"))
        .map(|f| f.strip_prefix(&root).expect("under src").to_string_lossy().into_owned())
        .collect();
    allowed.sort();
    let known = ["camera/streaming.rs", "display/console.rs"];
    assert!(allowed.iter().all(|f| known.contains(&f.as_str())), "unsafe allowed in {allowed:?}");
}
