//! What may be said on the command line in place of a visor file, or beside one.

use super::config::{Config, Loaded};
use crate::calibration::LensConfig;
use crate::marker::Family;
use crate::scene::{AnchorConfig, ModelConfig, Scene};
use crate::style::StyleName;
use crate::{camera, display};
use std::path::{Path, PathBuf};

/// What is said on the command line: a settings file, or what is needed of one; what is said beside a file counts.
#[derive(clap::Args, Clone, Debug, Default)]
pub struct Wishes {
    /// Visor file
    #[arg(long, value_name = "FILE", required_unless_present = "model")]
    pub config: Option<PathBuf>,
    /// The model instead of the file's: teapot, spot, or an OBJ, .glb, PLY or STL file
    #[arg(long, value_name = "M")]
    pub model: Option<String>,
    /// Marker of --model, such as tag36h11:7; every tag36h11 if not said
    #[arg(long, value_name = "FAMILY[:ID]", requires = "model", value_parser = marker)]
    pub marker: Option<(Family, Option<u32>)>,
    /// Printed side of the black square of --model's marker, mm; 80 if not said, as `vernissage sheet` prints it
    #[arg(long, value_name = "MM", requires = "model", allow_negative_numbers = true)]
    pub side_mm: Option<f64>,
    /// The style
    #[arg(long, value_enum, value_name = "S")]
    pub style: Option<StyleName>,
    /// The camera: auto, a node such as /dev/video0, synthetic, or a clip
    #[arg(long, value_name = "C")]
    pub camera: Option<String>,
    /// The display: kms (the screen), window (on a desktop), NAME.y4m, a folder for pictures, or null
    #[arg(long, value_name = "D")]
    pub display: Option<String>,
    /// Calibration of the camera's lens, as `vernissage calibrate` leaves it
    #[arg(long, value_name = "FILE")]
    pub lens: Option<PathBuf>,
}

/// A family, with a number or without.
fn marker(text: &str) -> Result<(Family, Option<u32>), String> {
    let (name, id) = match text.split_once(':') {
        Some((name, id)) => {
            (name, Some(id.parse().map_err(|_| format!("`{id}` is no number: write it as tag36h11:7"))?))
        }
        None => (text, None),
    };
    Ok((Family::from_name(name).map_err(|e| e.to_string())?, id))
}

impl Wishes {
    /// The scenes to step through, by name: those that the file lists, else what is meant itself.
    pub fn scenes(&self) -> anyhow::Result<Vec<(String, Loaded)>> {
        self.name(self.load()?)
    }

    /// The same with `text` in the place of what stands in the settings file.
    pub fn scenes_of(&self, text: &str) -> anyhow::Result<Vec<(String, Loaded)>> {
        self.name(self.add(match &self.config {
            Some(path) => Loaded::parse(text, path)?,
            None => return self.scenes(),
        })?)
    }

    fn name(&self, loaded: Loaded) -> anyhow::Result<Vec<(String, Loaded)>> {
        let name = self.config.as_deref().or(self.model.as_deref().map(Path::new));
        Ok(loaded.scenes(name.unwrap_or(Path::new("scene")))?)
    }

    /// The settings and models that are meant.
    pub fn load(&self) -> anyhow::Result<Loaded> {
        self.add(match &self.config {
            Some(path) => Loaded::read(path)?,
            None => Loaded { config: Config::default(), scene: Scene::default() },
        })
    }

    /// The display that is meant where a file says `display`.
    pub fn shown_on(&self, mut display: display::Config) -> display::Config {
        if let Some(word) = &self.display {
            show(word, &mut display);
        }
        display
    }

    /// What is said beside the file.
    fn add(&self, mut loaded: Loaded) -> anyhow::Result<Loaded> {
        let config = &mut loaded.config;
        if let Some(file) = &self.model {
            let before = config.model.first().map(|model| model.marker.clone());
            let mut anchor = before.unwrap_or(AnchorConfig::new(None, None, None));
            if let Some((family, id)) = self.marker {
                anchor = AnchorConfig::new(Some(family), id, Some(anchor.side_mm));
            }
            anchor.side_mm = self.side_mm.unwrap_or(anchor.side_mm);
            config.model = vec![ModelConfig::new(file.clone(), anchor)];
            let scene = Scene::build(&config.model, &config.light, Path::new("."))
                .map_err(|e| anyhow::anyhow!("--model {file}: {}", e.reason))?;
            loaded.scene = scene.on_boards(&config.board)?;
        }
        if let Some(style) = self.style {
            config.style.name = style;
        }
        if let Some(camera) = &self.camera {
            watch(camera, &mut config.camera);
        }
        config.display = self.shown_on(std::mem::take(&mut config.display));
        if let Some(path) = &self.lens {
            config.lens = Some(LensConfig::read(path)?);
        }
        Ok(loaded)
    }
}

/// The camera that a word means.
fn watch(word: &str, camera: &mut camera::Config) {
    let is_file = |path: &Path| !path.starts_with("/dev") && path.exists();
    if word == "synthetic" {
        camera.source = camera::Kind::Synthetic;
    } else if word == "-" || is_file(Path::new(word)) {
        (camera.source, camera.path) = (camera::Kind::Clip, word.into());
    } else {
        (camera.source, camera.device) = (camera::Kind::V4l2, word.into());
    }
}

/// The display that a word means: a sink's name, else a file or folder.
fn show(word: &str, display: &mut display::Config) {
    let is_clip = word == "-" || word.to_ascii_lowercase().ends_with(".y4m");
    display.sink = match toml::Value::from(word).try_into() {
        Ok(kind) if !matches!(kind, display::Kind::Y4m | display::Kind::Png) => kind,
        _ => {
            display.path = Some(word.into());
            if is_clip { display::Kind::Y4m } else { display::Kind::Png }
        }
    };
}
