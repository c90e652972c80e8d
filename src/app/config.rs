//! The settings file: composes what each room documents for itself, and turns a mistake in it into one line
//! that names file, line and the nearest word that would have been right.

use crate::calibration::{FileError, LensConfig};
use crate::geometry::Lens;
use crate::pipeline::governor;
use crate::pixels::Size;
use crate::scene::{BoardConfig, LightConfig, ModelConfig, Scene};
use crate::{buttons, camera, display, retouch, style, track};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// A scene or visor file. Every table may be left out.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// Threads that compute, 1..64; 0 = 2.
    pub threads: usize,
    /// Where pictures come from.
    pub camera: camera::Config,
    /// How the camera sees.
    pub lens: Option<LensConfig>,
    /// How markers are found.
    pub track: track::Config,
    /// The models, each on a marker.
    pub model: Vec<ModelConfig>,
    /// Prints that are fixed to one another.
    pub board: Vec<BoardConfig>,
    /// The light on the models.
    pub light: LightConfig,
    /// What is done to the camera picture before it is drawn.
    pub retouch: retouch::Config,
    /// How the picture is drawn.
    pub style: style::Config,
    /// Where it is shown.
    pub display: display::Config,
    /// Buttons on a serial line.
    pub serial: buttons::Config,
    /// Keys of the kernel's input layer as buttons; off unless given.
    pub keys: Option<buttons::keys::Config>,
    /// Scene files that presses step through, relative to this file; the first is shown first. Their tables (model,
    /// board, light, retouch, style, track) stand in place of this file's.
    pub scenes: Vec<PathBuf>,
    /// Keeps frames to a budget; off unless given.
    pub governor: Option<governor::Config>,
    /// Pictures kept on request; off unless given.
    pub snapshot: Option<SnapshotConfig>,
}

/// The `[snapshot]` table: without it nothing is ever kept.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SnapshotConfig {
    /// The folder, relative to the settings file.
    pub dir: PathBuf,
}

/// What a scene file may hold.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneFile {
    model: Option<Vec<ModelConfig>>,
    board: Option<Vec<BoardConfig>>,
    light: Option<LightConfig>,
    retouch: Option<retouch::Config>,
    style: Option<style::Config>,
    track: Option<track::Config>,
}

/// Why a settings file cannot be used; its text is one line.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: cannot read settings: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A word, type or value in the file is wrong.
    #[error("{}:{line}: {reason}", path.display())]
    Wrong {
        /// The file.
        path: PathBuf,
        /// Line, counted from 1.
        line: usize,
        /// What is wrong and what to do.
        reason: String,
    },
    /// The calibration that it names cannot be used.
    #[error(transparent)]
    Lens(#[from] FileError),
}

/// A settings file, read, with the models loaded.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// What the file says.
    pub config: Config,
    /// The models and the light.
    pub scene: Scene,
}

impl Config {
    /// Parses settings; `path` is for messages.
    pub fn parse(text: &str, path: &Path) -> Result<Config, ConfigError> {
        let config: Config = read_toml(text, path)?;
        config.check(text, path)?;
        Ok(config)
    }

    /// These settings with the tables of a scene file in place of their own, and whether what stands on the markers
    /// is among them; `path` is for messages.
    pub(super) fn with_scene(&self, text: &str, path: &Path) -> Result<(Config, bool), ConfigError> {
        let file: SceneFile = read_toml(text, path)?;
        let own_models = file.model.is_some() || file.board.is_some() || file.light.is_some();
        let mut config = self.clone();
        config.model = file.model.unwrap_or(config.model);
        config.board = file.board.unwrap_or(config.board);
        config.light = file.light.unwrap_or(config.light);
        config.retouch = file.retouch.unwrap_or(config.retouch);
        config.style = file.style.unwrap_or(config.style);
        config.track = file.track.unwrap_or(config.track);
        config.check(text, path)?;
        Ok((config, own_models))
    }

    /// Whether everything is within its range.
    fn check(&self, text: &str, path: &Path) -> Result<(), ConfigError> {
        let config = self;
        let wrong = |line, reason| ConfigError::Wrong { path: path.into(), line, reason };
        if config.threads > 64 {
            return Err(wrong(find_key(text, "threads"), format!("threads = {}: 1 to 64", config.threads)));
        }
        config.camera.check().map_err(|(key, reason)| wrong(find_key(text, key), reason))?;
        config.retouch.validate().map_err(|e| {
            let key = e.key.rsplit('.').next().unwrap_or("retouch");
            wrong(find_key(text, key), e.to_string())
        })?;
        config.serial.check().map_err(|(key, reason)| wrong(find_key(text, key), reason))?;
        config.style.validate().map_err(|e| wrong(find_key(text, "style"), e.to_string()))?;
        if let Some(lens) = &config.lens {
            lens.check().map_err(|reason| wrong(find_key(text, "lens"), reason))?;
        }
        if let Some(keys) = &config.keys {
            keys.check().map_err(|reason| wrong(find_key(text, "codes"), reason))?;
        }
        if let Some(governor) = &config.governor {
            governor.check().map_err(|reason| wrong(find_key(text, "budget_ms"), reason))?;
        }
        let names: Vec<String> = config.scenes.iter().map(|file| scene_name(file)).collect();
        if let Some(twice) = (1..names.len()).find(|&k| names[..k].contains(&names[k])) {
            let reason = format!("two scenes are called {}: rename a file", names[twice]);
            return Err(wrong(find_key(text, "scenes"), reason));
        }
        Ok(())
    }

    /// Threads to compute with.
    pub fn threads(&self) -> usize {
        if self.threads == 0 { 2 } else { self.threads }
    }

    /// The lens for pictures of `size`: the calibration scaled, or the guess where there is none (or it is
    /// for pictures of another shape); the second value says which guess was made.
    pub fn lens(&self, size: Size) -> (Lens, Option<String>) {
        let guess = Lens::guess(size);
        let Some(lens) = &self.lens else {
            let focal = guess.focal.x;
            return (guess, Some(format!("no [lens] calibration: taking fx = fy = {focal} px, centered")));
        };
        match lens.lens(size) {
            Some(lens) => (lens, None),
            None => {
                let focal = guess.focal.x;
                let text =
                    format!("[lens] is for {}, pictures are {size}: taking fx = fy = {focal}", lens.size());
                (guess, Some(text))
            }
        }
    }
}

impl Loaded {
    /// Reads a settings file and the models it names (paths in it are relative to it).
    pub fn read(path: &Path) -> Result<Loaded, ConfigError> {
        let read = |source| ConfigError::Read { path: path.into(), source };
        Self::parse(&std::fs::read_to_string(path).map_err(read)?, path)
    }

    /// The same of a text that stands, or stood, in that file.
    pub fn parse(text: &str, path: &Path) -> Result<Loaded, ConfigError> {
        let mut config = Config::parse(text, path)?;
        let folder = path.parent().unwrap_or(Path::new("."));
        config.camera.resolve(folder);
        if let Some(snapshot) = &mut config.snapshot {
            snapshot.dir = folder.join(&snapshot.dir);
        }
        if let Some(file) = config.lens.as_ref().and_then(|lens| lens.file.as_ref()) {
            config.lens = Some(LensConfig::read(&folder.join(file))?);
        }
        for file in &mut config.scenes {
            *file = folder.join(&file);
        }
        Loaded::build(config, text, path)
    }

    /// The scenes to step through, by name: those that the file lists, else what it says itself.
    pub fn scenes(self, path: &Path) -> Result<Vec<(String, Loaded)>, ConfigError> {
        if self.config.scenes.is_empty() {
            return Ok(vec![(scene_name(path), self)]);
        }
        let scene = |file: &PathBuf| Ok((scene_name(file), self.scene(file)?));
        self.config.scenes.iter().map(scene).collect()
    }

    /// What a scene file makes of these settings.
    fn scene(&self, path: &Path) -> Result<Loaded, ConfigError> {
        let read = |source| ConfigError::Read { path: path.into(), source };
        let text = std::fs::read_to_string(path).map_err(read)?;
        let (config, own_models) = self.config.with_scene(&text, path)?;
        if own_models {
            return Loaded::build(config, &text, path);
        }
        Ok(Loaded { config, scene: self.scene.clone() })
    }

    fn build(config: Config, text: &str, path: &Path) -> Result<Loaded, ConfigError> {
        let folder = path.parent().unwrap_or(Path::new("."));
        let scene = Scene::build(&config.model, &config.light, folder).map_err(|e| ConfigError::Wrong {
            path: path.into(),
            line: nth_table(text, "[[model]]", e.number),
            reason: e.to_string(),
        })?;
        let scene = scene.on_boards(&config.board).map_err(|e| ConfigError::Wrong {
            path: path.into(),
            line: nth_table(text, "[[board]]", e.number),
            reason: e.to_string(),
        })?;
        Ok(Loaded { config, scene })
    }
}

/// A scene is called as its file, without the end.
fn scene_name(path: &Path) -> String {
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

fn read_toml<T: serde::de::DeserializeOwned>(text: &str, path: &Path) -> Result<T, ConfigError> {
    toml::from_str(text).map_err(|e| {
        let line = e.span().map_or(1, |span| line_of(text, span.start));
        ConfigError::Wrong { path: path.into(), line, reason: explain(e.message()) }
    })
}

/// The line (from 1) that holds the byte at `at`.
pub(super) fn line_of(text: &str, at: usize) -> usize {
    text.as_bytes()[..at.min(text.len())].iter().filter(|&&b| b == b'\n').count() + 1
}

/// The first line whose key or table header is `key`; 1 when there is none.
pub(super) fn find_key(text: &str, key: &str) -> usize {
    let names = |line: &str| {
        let line = line.trim_start_matches(['[', ' ', '\t']);
        line.strip_prefix(key).is_some_and(|rest| rest.trim_start().starts_with([']', '=', '.']))
    };
    text.lines().position(names).map_or(1, |index| index + 1)
}

/// The line of the nth (from 1) table header.
pub(super) fn nth_table(text: &str, header: &str, n: usize) -> usize {
    let mut headers = text.lines().enumerate().filter(|(_, line)| line.trim().starts_with(header));
    headers.nth(n.saturating_sub(1)).map_or(1, |(index, _)| index + 1)
}

/// The parser's message in one line, the nearest valid word before all of them where it lists them.
fn explain(message: &str) -> String {
    let message = message.lines().map(str::trim).filter(|l| !l.is_empty()).collect::<Vec<_>>().join(", ");
    let Some((said, valid)) = message.split_once("expected one of ").or(message.split_once(", expected `"))
    else {
        return message;
    };
    let quoted = |text: &str| text.split('`').skip(1).step_by(2).map(str::to_string).collect::<Vec<_>>();
    let valid =
        if message.contains("expected one of") { quoted(valid) } else { quoted(&format!("`{valid}")) };
    let Some(word) = quoted(said).into_iter().next() else { return message };
    match nearest(&word, &valid) {
        Some(best) => {
            let expected = message[said.len()..].trim_start_matches(", ").trim_end_matches('.');
            format!("{}; did you mean `{best}`? ({expected})", said.trim_end_matches([',', ' ']))
        }
        None => message,
    }
}

/// The valid word that `word` is the beginning of, else the one with the fewest edits to it.
fn nearest<'a>(word: &str, valid: &'a [String]) -> Option<&'a str> {
    let edits = |candidate: &&str| (!candidate.starts_with(word), strsim::levenshtein(word, candidate));
    valid.iter().map(String::as_str).min_by_key(edits)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        Config::parse(text, Path::new("visor.toml")).expect_err("must be refused").to_string()
    }

    #[test]
    fn a_wrong_key_names_file_line_and_the_nearest_word() {
        let message = error("threads = 2\n\n[light]\nambiant = 0.2\n");
        assert!(message.starts_with("visor.toml:4: "), "{message}");
        assert!(message.contains("did you mean `ambient`?"), "{message}");
        assert_eq!(message.lines().count(), 1);
    }

    #[test]
    fn every_boards_file_is_read() {
        let folder = Path::new("board");
        let files = std::fs::read_dir(folder).expect("the boards").flatten().map(|file| file.path());
        let mut boards: Vec<_> =
            files.filter(|path| path.extension().is_some_and(|end| end == "toml")).collect();
        boards.sort();
        let names: Vec<_> = boards.iter().filter_map(|path| path.file_stem()?.to_str()).collect();
        assert_eq!(names, ["laptop", "rpi4", "rpi5", "virtual"]);
        for path in &boards {
            let loaded = Loaded::read(path).expect("a visor file");
            assert_eq!((loaded.scene.models.len(), loaded.config.display.sink), (1, display::Kind::Kms));
        }
    }

    #[test]
    fn a_wrong_value_names_the_line() {
        let message = error("[style]\nname = \"cartoony\"\n");
        assert!(message.starts_with("visor.toml:2: ") && message.contains("`cartoon`"), "{message}");
        assert!(
            error("[lens]\nwidth = 0\nheight = 1\nfx = 1\nfy = 1\ncx = 0\ncy = 0\n").contains("visor.toml:1")
        );
        assert!(error("threads = 99").contains("1 to 64"));
        assert!(error("threads = ").contains("visor.toml:1"));
    }

    #[test]
    fn a_camera_beyond_its_ranges_is_refused() {
        assert!(error("[camera]\nwidth = 0\n").starts_with("visor.toml:2: camera.width = 0"));
        assert!(error("[camera]\nfps = nan\n").contains("camera.fps = NaN"));
        let text = "[camera]\nsource = \"synthetic\"\n[camera.synthetic]\nid = 587\n";
        assert!(
            error(text).starts_with("visor.toml:4: camera.synthetic.id = 587: tag36h11 has ids 0 to 586")
        );
        assert!(error("[camera.synthetic]\nside_mm = inf\n").contains("camera.synthetic.side_mm = inf"));
    }

    #[test]
    fn buttons_mean_what_they_are_told_to() {
        use buttons::{Action, Kind};
        let text = "[serial]\nport = \"/dev/ttyACM0\"\nconsole = \"full\"\n\n[[serial.button]]\nnumber = 4\n\
                    short = \"freeze\"\ndouble = \"style-previous\"\n";
        let serial = Config::parse(text, Path::new("a")).expect("valid").serial;
        assert_eq!((serial.baud, serial.console), (115_200, buttons::Console::Full));
        assert_eq!(serial.action(4, Kind::Double), Some(Action::StylePrevious));
        assert_eq!((serial.action(4, Kind::Long), serial.action(1, Kind::Short)), (None, None));
        assert!(serial.wanted()[3].double && !serial.wanted()[3].long);
        let usual = buttons::Config::default();
        assert_eq!(usual.action(1, Kind::Long), Some(Action::Standby));
        assert!(error("[serial]\nbaud = 7\n").starts_with("visor.toml:2: serial.baud = 7: 1200 to"));
        assert!(
            error("[[serial.button]]\nshort = \"freeze\"\nnumber = 0\n")
                .starts_with("visor.toml:3: serial.button")
        );
        let twice = "[[serial.button]]\nnumber = 2\n".repeat(2);
        assert!(error(&twice).contains("button 2 has two tables"));
        assert!(error("[[serial.button]]\nnumber = 2\nshort = \"style\"\n").contains("`style-next`"));
    }

    #[test]
    fn retouches_are_off_unless_their_table_is_there() {
        let parse = |text: &str| Config::parse(text, Path::new("a")).expect("valid");
        assert_eq!(parse("").retouch, retouch::Config::default());
        let some = parse("[retouch.steady]\n[retouch.hide]\nmargin = 2.2\n[style.part]\nof = \"object\"\n");
        assert!(some.retouch.steady.is_some() && some.retouch.light.is_none() && some.style.part.is_some());
        let message = error("[retouch.shadow]\n\nstrength = 2\n");
        assert!(
            message.starts_with("visor.toml:3: retouch.shadow.strength = 2 is out of range: 0 to 1"),
            "{message}"
        );
        assert!(error("[retouch.hide]\nmargins = 1\n").contains("`margin`"));
    }

    #[test]
    fn scenes_stand_in_place_of_the_files_own() {
        let folder = std::env::temp_dir().join(format!("vernissage-scenes-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let write = |name: &str, text: &str| std::fs::write(folder.join(name), text).expect("written");
        write("a.toml", "[style]\nname = \"sketchy\"\n");
        write("b.toml", "[[model]]\nfile = \"spot\"\nmarker = {}\n");
        write("visor.toml", "scenes = [\"a.toml\", \"b.toml\"]\n[[model]]\nfile = \"teapot\"\nmarker = {}\n");
        let visor = folder.join("visor.toml");
        let scenes = || Loaded::read(&visor).and_then(|loaded| loaded.scenes(&visor));
        let two = scenes().expect("two scenes");
        let model = |k: usize| two[k].1.scene.models[0].name.as_str();
        assert_eq!((two[0].0.as_str(), model(0), two[1].0.as_str(), model(1)), ("a", "teapot", "b", "spot"));
        assert_eq!([0, 1].map(|k| two[k].1.config.style.name.name()), ["sketchy", "cartoon"]);
        write("a.toml", "[camera]\nwidth = 3\n");
        assert!(
            scenes().expect_err("not in a scene").to_string().contains("a.toml:1: unknown field `camera`")
        );
        write("a.toml", "\n[style]\nfade_ms = 9999\n");
        assert!(scenes().expect_err("out of range").to_string().contains("a.toml:2: style.fade_ms = 9999"));
        write("visor.toml", "threads = 1\n");
        assert_eq!(scenes().expect("itself")[0].0, "visor");
        assert!(
            error("scenes = [\"a.toml\", \"x/a.toml\"]\n").contains("visor.toml:1: two scenes are called a")
        );
        std::fs::remove_dir_all(&folder).expect("its own folder");
    }

    #[test]
    fn a_calibration_scales_with_the_picture() {
        let text = "[lens]\nwidth=640\nheight=480\nfx=600\nfy=610\ncx=319.5\ncy=239.5\ndist=[-0.2,0,0,0]\n";
        let config = Config::parse(text, Path::new("a")).expect("valid");
        let (lens, warning) = config.lens(Size::new(1280, 960));
        assert!(warning.is_none());
        assert_eq!((lens.focal.x, lens.center.x, lens.distortion[0]), (1200.0, 639.5, -0.2));
        assert!(config.lens(Size::new(1280, 720)).1.is_some(), "another shape is no scaled calibration");
    }
}
