//! `vernissage check`: everything that is wrong with a visor file, at once.
//!
//! The settings' parser stops at the first mistake. Here the statement with the mistake is taken out and the rest is
//! parsed again, until nothing is wrong; then what the settings name is looked for. No device is opened.

use super::config::{Config, ConfigError, find_key, nth_table};
use super::say;
use crate::buttons::Action;
use crate::calibration::LensConfig;
use crate::scene::Scene;
use crate::{camera, display};
use rustix::fs::Access;
use std::os::unix::fs::FileTypeExt;
use std::path::{Path, PathBuf};

/// Lists everything that would keep a visor file from running, with the line and what to do.
///
/// The file's words and values, the scene files, models, textures and calibration it names, markers and boards; and
/// whether the camera, the screen, the serial port and the input device it names are there (nothing is opened), and
/// whether you may write to the folder for snapshots. Exit code 0 where nothing is wrong, else 2.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage check visor.toml\n  \
    vernissage check visor.toml --no-devices        a file for another machine")]
pub struct Args {
    /// Visor file
    #[arg(value_name = "FILE")]
    config: PathBuf,
    /// Do not look for devices
    #[arg(long)]
    no_devices: bool,
    /// Print each problem as a JSON object
    #[arg(long)]
    json: bool,
}

/// Something wrong.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// Where, as `FILE:LINE`; the file alone where no line says it.
    pub place: String,
    /// What, and what to do.
    pub what: String,
}

/// Mistakes after which no more are looked for.
const MOST: usize = 100;

pub fn run(args: Args) -> anyhow::Result<()> {
    let (problems, config) = problems(&args.config, !args.no_devices);
    for Problem { place, what } in &problems {
        if args.json {
            say(serde_json::json!({ "place": place, "problem": what }))?;
        } else {
            say(format_args!("{place}: {what}"))?;
        }
    }
    let (path, count) = (args.config.display(), problems.len());
    match count {
        0 if args.json => Ok(()),
        0 => {
            let models = config.as_ref().map_or(0, |config| config.model.len());
            let scenes = config.as_ref().map_or(0, |config| config.scenes.len());
            let scenes = if scenes == 0 { String::new() } else { format!(", {scenes} scenes") };
            let style = config.map(|config| config.style.name).unwrap_or_default();
            say(format_args!("{path}: nothing is wrong; {models} models, style {style}{scenes}"))
        }
        1 => anyhow::bail!("{path}: 1 problem"),
        _ => anyhow::bail!("{path}: {count} problems"),
    }
}

/// Everything that is wrong, and the settings as far as they could be read.
pub fn problems(path: &Path, devices: bool) -> (Vec<Problem>, Option<Config>) {
    let mut found = Vec::new();
    let text = match std::fs::read_to_string(path) {
        Ok(text) => text,
        Err(error) => {
            let what = format!("cannot read settings: {error}; give the path of a visor file");
            return (vec![Problem { place: path.display().to_string(), what }], None);
        }
    };
    let (rest, config) = parsed(&text, path, |text| Config::parse(text, path), &mut found);
    if let Some(config) = &config {
        let folder = path.parent().unwrap_or(Path::new("."));
        let add = &mut adding(path, &mut found);
        scene(config, &rest, folder, add);
        if config.model.is_empty() && config.scenes.is_empty() {
            add(None, NO_MODEL.into());
        }
        files(config, &rest, folder, add);
        presses(config, &rest, add);
        if devices {
            self::devices(config, &rest, folder, add);
        }
    }
    in_order(&mut found);
    // scene after scene, behind the file that names them
    for file in config.iter().flat_map(|config| &config.scenes) {
        let named = path.parent().unwrap_or(Path::new(".")).join(file);
        let mut own = Vec::new();
        match std::fs::read_to_string(&named) {
            Ok(text) => config.iter().for_each(|config| scene_file(config, &text, &named, &mut own)),
            Err(error) => {
                let what = format!("scenes: {}: {error}; give the paths of scene files", named.display());
                adding(path, &mut own)(Some(find_key(&text, "scenes")), what);
            }
        }
        in_order(&mut own);
        found.append(&mut own);
    }
    (found, config)
}

const NO_MODEL: &str = "no [[model]]: nothing will stand on any marker; name one, such as file = \"teapot\"";

/// Everything that is wrong with a scene file.
fn scene_file(visor: &Config, text: &str, path: &Path, found: &mut Vec<Problem>) {
    let (rest, both) = parsed(text, path, |text| visor.with_scene(text, path), found);
    let Some((config, own_models)) = both else { return };
    let add = &mut adding(path, found);
    // what stands in the visor file has been told there
    if own_models {
        scene(&config, &rest, path.parent().unwrap_or(Path::new(".")), add);
    }
    if config.model.is_empty() {
        add(None, NO_MODEL.into());
    }
}

/// Adds to `found` what was not told before; the line is one of the file at `path`.
fn adding<'a>(path: &'a Path, found: &'a mut Vec<Problem>) -> impl FnMut(Option<usize>, String) + 'a {
    move |line, what| {
        let place = match line {
            Some(line) => format!("{}:{line}", path.display()),
            None => path.display().to_string(),
        };
        let problem = Problem { place, what };
        if !found.contains(&problem) {
            found.push(problem);
        }
    }
}

/// By line; what has none comes last.
fn in_order(found: &mut [Problem]) {
    found.sort_by_key(|problem| {
        let line = problem.place.rsplit(':').next().and_then(|line| line.parse::<usize>().ok());
        line.unwrap_or(usize::MAX)
    });
}

/// What `parse` makes of the text without the statements that are wrong, and what was left of it.
fn parsed<T>(
    text: &str,
    path: &Path,
    parse: impl Fn(&str) -> Result<T, ConfigError>,
    found: &mut Vec<Problem>,
) -> (String, Option<T>) {
    let mut lines: Vec<String> = text.lines().map(str::to_string).collect();
    let mut removed: Vec<String> = Vec::new();
    let mut last = String::new();
    for _ in 0..MOST {
        let rest = lines.join("\n");
        let error = match parse(&rest) {
            Ok(config) => return (rest, Some(config)),
            Err(error) => error,
        };
        let ConfigError::Wrong { line, reason, .. } = &error else { break };
        let missing = reason.strip_prefix("missing field `").and_then(|r| r.split('`').next());
        // what is missing because it was wrong has been told
        let told = missing.is_some_and(|key| removed.iter().any(|name| name == key));
        let problem = Problem { place: format!("{}:{line}", path.display()), what: reason.clone() };
        if *reason == last || lines.get(line - 1).is_none_or(|line| line.trim().is_empty()) {
            // it is still there: the line was a guess
            if !told && !found.contains(&problem) {
                found.push(problem);
            }
            return (rest, None);
        }
        if !told && !found.contains(&problem) {
            found.push(problem);
        }
        last = reason.clone();
        let (from, to) =
            if missing.is_some() { table(&lines, line - 1) } else { statement(&lines, line - 1) };
        for line in &mut lines[from..to] {
            removed.extend(line.split(['=', '{', ',', '[', ']']).map(|word| word.trim().to_string()));
            line.clear();
        }
    }
    (String::new(), None)
}

/// The lines of the statement that a line belongs to: up to where its brackets are closed.
fn statement(lines: &[String], at: usize) -> (usize, usize) {
    let mut from = 0;
    while from < lines.len() {
        let (mut depth, mut to) = (0i32, from);
        while to < lines.len() {
            depth += brackets(&lines[to]);
            to += 1;
            if depth <= 0 {
                break;
            }
        }
        if at < to {
            return (from, to);
        }
        from = to;
    }
    (at, (at + 1).min(lines.len()))
}

/// Opening brackets less closing ones, outside strings and remarks.
fn brackets(line: &str) -> i32 {
    let (mut depth, mut quote, mut escaped) = (0, None, false);
    for c in line.chars() {
        match quote {
            Some('"') if escaped => escaped = false,
            Some('"') if c == '\\' => escaped = true,
            Some(open) if c == open => quote = None,
            Some(_) => {}
            None => match c {
                '"' | '\'' => quote = Some(c),
                '#' => break,
                '[' | '{' => depth += 1,
                ']' | '}' => depth -= 1,
                _ => {}
            },
        }
    }
    depth
}

/// The lines of the table (or of the statement, where that holds an inline one) that a line belongs to.
fn table(lines: &[String], at: usize) -> (usize, usize) {
    let header = |line: &String| line.trim_start().starts_with('[');
    if !header(&lines[at]) {
        return statement(lines, at);
    }
    let to = lines[at + 1..].iter().position(header).map_or(lines.len(), |next| at + 1 + next);
    (at, to)
}

type Add<'a> = dyn FnMut(Option<usize>, String) + 'a;

/// Models and boards: each alone, then all together.
fn scene(config: &Config, text: &str, folder: &Path, add: &mut Add<'_>) {
    let mut sound = true;
    for (k, model) in config.model.iter().enumerate() {
        if let Err(error) = Scene::build(std::slice::from_ref(model), &config.light, folder) {
            sound = false;
            add(
                Some(nth_table(text, "[[model]]", k + 1)),
                format!("[[model]] {}: {}", error.file, error.reason),
            );
        }
    }
    let alone = Scene::default();
    for (k, board) in config.board.iter().enumerate() {
        if let Err(error) = alone.clone().on_boards(std::slice::from_ref(board)) {
            sound = false;
            add(Some(nth_table(text, "[[board]]", k + 1)), format!("[[board]]: {}", error.reason));
        }
    }
    if !sound {
        return;
    }
    match Scene::build(&config.model, &config.light, folder) {
        Err(error) => add(Some(nth_table(text, "[[model]]", error.number)), error.to_string()),
        Ok(scene) => {
            if let Err(error) = scene.on_boards(&config.board) {
                add(Some(nth_table(text, "[[board]]", error.number)), error.to_string());
            }
        }
    }
}

/// Presses that would do nothing.
fn presses(config: &Config, text: &str, add: &mut Add<'_>) {
    for (k, button) in config.serial.button.iter().enumerate() {
        let mut lacks = |action, what: &str| {
            if [button.short, button.long, button.double].contains(&Some(action)) {
                let line = nth_table(text, "[[serial.button]]", k + 1);
                add(Some(line), format!("button {}: {} {what}", button.number, action.name()));
            }
        };
        if config.snapshot.is_none() {
            lacks(
                Action::Snapshot,
                "does nothing without [snapshot]: name its folder, such as dir = \"kept\"",
            );
        }
        if config.scenes.len() < 2 {
            lacks(Action::SceneNext, "does nothing: list two or more files in `scenes`");
        }
    }
}

/// Whether pictures could be written to a folder, which need not be there; else what is in the way.
fn can_keep(folder: &Path) -> Result<(), String> {
    let there = folder.ancestors().find(|part| part.exists() || part.as_os_str().is_empty());
    let there = there.filter(|part| !part.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if !there.is_dir() {
        return Err(format!("{} is no folder", there.display()));
    }
    let right = Access::WRITE_OK | Access::EXEC_OK;
    rustix::fs::access(there, right).map_err(|error| format!("{}: {error}", there.display()))
}

/// Files to be read and written.
fn files(config: &Config, text: &str, folder: &Path, add: &mut Add<'_>) {
    let line = |key| Some(find_key(text, key));
    if let Some(file) = config.lens.as_ref().and_then(|lens| lens.file.as_ref())
        && let Err(error) = LensConfig::read(&folder.join(file))
    {
        add(line("lens"), error.to_string());
    }
    if matches!(config.camera.source, camera::Kind::Clip | camera::Kind::Trace) {
        let mut camera = config.camera.clone();
        camera.resolve(folder);
        if camera.path.as_os_str().is_empty() {
            add(line("source"), "camera.path names no clip: give a folder of pictures or a Y4M file".into());
        } else if camera.path != Path::new("-") && !camera.path.exists() {
            add(line("path"), format!("camera.path: {} is not there", camera.path.display()));
        }
    }
    if matches!(config.display.sink, display::Kind::Y4m | display::Kind::Png) {
        match &config.display.path {
            None => add(line("sink"), "this display.sink needs display.path: name a file or folder".into()),
            Some(path) if path == Path::new("-") => {}
            Some(path) => {
                let parent = path.parent().filter(|parent| !parent.as_os_str().is_empty());
                if parent.is_some_and(|parent| config.display.sink == display::Kind::Y4m && !parent.is_dir())
                {
                    add(line("sink"), format!("display.path: the folder of {} is not there", path.display()));
                }
            }
        }
    }
}

/// What is named and is this machine's: devices, the folder for snapshots.
fn devices(config: &Config, text: &str, home: &Path, add: &mut Add<'_>) {
    let line = |key: &str| {
        let at = find_key(text, key);
        // 1 also means that the key is not there
        (at > 1 || text.trim_start().starts_with(key)).then_some(at)
    };
    let is_node = |path: &Path| std::fs::metadata(path).is_ok_and(|m| m.file_type().is_char_device());
    let nodes = |folder: &str, name: &str| -> Vec<String> {
        let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
        let mut nodes: Vec<String> = entries
            .filter(|entry| entry.file_name().to_string_lossy().starts_with(name))
            .map(|entry| entry.path().display().to_string())
            .collect();
        nodes.sort();
        nodes
    };
    let there = |nodes: &[String]| match nodes {
        [] => "there is none".to_string(),
        nodes => format!("there is {}", nodes.join(", ")),
    };
    if config.camera.source == camera::Kind::V4l2 {
        let (device, all) = (&config.camera.device, nodes("/dev", "video"));
        if device.starts_with('/') && !is_node(Path::new(device)) {
            add(line("device"), format!("camera.device: {device} is no device; {}", there(&all)));
        } else if all.is_empty() {
            let what =
                "no camera (/dev/video*): plug one in, or set camera.source = \"synthetic\" to try without";
            add(line("camera"), what.into());
        }
    }
    if config.display.sink == display::Kind::Kms {
        let (card, all) = (&config.display.card, nodes("/dev/dri", "card"));
        if card.starts_with('/') && !is_node(Path::new(card)) {
            add(line("card"), format!("display.card: {card} is no device; {}", there(&all)));
        } else if all.is_empty() {
            let what = "no screen (/dev/dri/card*): load its driver, or set display.sink to \"window\" (on a desktop), \"y4m\", \"png\" or \"null\"";
            add(line("display"), what.into());
        }
    }
    if config.display.sink == display::Kind::Window {
        if !cfg!(feature = "window") {
            add(
                line("sink"),
                "this program is built without windows: build it with its default features".into(),
            );
        } else if std::env::var_os("DISPLAY").is_none_or(|server| server.is_empty()) {
            add(
                line("sink"),
                "no desktop (DISPLAY names no X server): start from one, or set another display.sink".into(),
            );
        }
    }
    if let Some(port) = &config.serial.port
        && !is_node(port)
    {
        let ports: Vec<String> =
            ["ttyACM", "ttyUSB", "ttyAMA"].into_iter().flat_map(|name| nodes("/dev", name)).collect();
        add(line("port"), format!("serial.port: {} is no device; {}", port.display(), there(&ports)));
    }
    if let Some(keys) = &config.keys
        && !is_node(&keys.device)
    {
        let (device, all) = (keys.device.display(), nodes("/dev/input", "event"));
        add(line("keys"), format!("keys.device: {device} is no device; {}", there(&all)));
    }
    if let Some(snapshot) = &config.snapshot
        && let Err(reason) = can_keep(&home.join(&snapshot.dir))
    {
        add(line("dir"), format!("snapshot.dir: {reason}; name a folder that the visor may write to"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn statements_end_where_their_brackets_close() {
        let lines: Vec<String> =
            ["a = 1", "b = [ # [", "  \"]\", 2,", "]", "[c]", "d = { e = [1] }"].map(String::from).to_vec();
        for (at, range) in [(0, (0, 1)), (1, (1, 4)), (2, (1, 4)), (3, (1, 4)), (4, (4, 5)), (5, (5, 6))] {
            assert_eq!(statement(&lines, at), range, "{at}");
        }
        assert_eq!(table(&lines, 4), (4, 6));
        let open: Vec<String> = ["a = [", "b = 2"].map(String::from).to_vec();
        assert_eq!(statement(&open, 1), (0, 2));
    }
}
