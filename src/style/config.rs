//! Settings of all styles: what the scene file's `[style]` table and `--set key=value` reach.

use super::{bilateral, cartoon, illustrative, pointillism, sketchy, watercolor};
use crate::retouch::{RangeError, part};
use serde::{Deserialize, Serialize};

/// The styles by name.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize, clap::ValueEnum)]
#[serde(rename_all = "kebab-case")]
pub enum StyleName {
    /// Conventional augmented reality: the models over the camera picture.
    Plain,
    /// Flat colors and black outlines from one filter over the whole augmented picture.
    #[default]
    Cartoon,
    /// Flat colors from a bilateral filter, thick black outlines from Canny's edges.
    BilateralCartoon,
    /// Thick black outlines on white.
    SketchLike,
    /// Colors that bleed over edges in Voronoi cells, black edges on top.
    Watercolor,
    /// Black edges and cross-hatching on paper.
    Illustrative,
    /// Thousands of small brush strokes.
    Pointillism,
    /// Blurred colors on paper under pencil strokes along the silhouettes.
    Sketchy,
}

impl StyleName {
    /// The name as typed and written in files.
    pub fn name(self) -> &'static str {
        match self {
            StyleName::Plain => "plain",
            StyleName::Cartoon => "cartoon",
            StyleName::BilateralCartoon => "bilateral-cartoon",
            StyleName::SketchLike => "sketch-like",
            StyleName::Watercolor => "watercolor",
            StyleName::Illustrative => "illustrative",
            StyleName::Pointillism => "pointillism",
            StyleName::Sketchy => "sketchy",
        }
    }

    /// Whether nothing of it can be simplified: see [`Config::simpler`].
    pub fn is_simple(self) -> bool {
        matches!(self, StyleName::Plain | StyleName::SketchLike | StyleName::Illustrative)
    }

    /// Whether it has a pattern that can be anchored.
    pub fn has_pattern(self) -> bool {
        use StyleName::{Illustrative, Pointillism, Sketchy, Watercolor};
        matches!(self, Watercolor | Illustrative | Pointillism | Sketchy)
    }
}

impl std::fmt::Display for StyleName {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(self.name())
    }
}

/// Which style is drawn, and each style's settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// The style to draw: "plain", "cartoon", "bilateral-cartoon", "sketch-like", "watercolor",
    /// "illustrative", "pointillism" or "sketchy". Default "cartoon".
    pub name: StyleName,
    /// Time over which one style fades into the next, ms, 0 (at once) to 5000. Default 300.
    pub fade_ms: u32,
    /// Styles that a visitor steps through, by name; they are built ahead. Default [] (only the one).
    pub cycle: Vec<StyleName>,
    /// Whether cells, hatching and strokes move with the surface that carries a marker instead of standing still in
    /// the picture. Default false.
    pub anchored: bool,
    /// Styles only part of the picture, the rest shows the models over the camera picture. Default: none, all of it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub part: Option<part::Config>,
    /// Settings of the cartoon style.
    pub cartoon: cartoon::Config,
    /// Settings of the bilateral cartoon style; the table is named as the style.
    #[serde(rename = "bilateral-cartoon")]
    pub bilateral_cartoon: bilateral::Config,
    /// Settings of the sketch-like style; the table is named as the style.
    #[serde(rename = "sketch-like")]
    pub sketch_like: bilateral::Lines,
    /// Settings of the watercolor style.
    pub watercolor: watercolor::Config,
    /// Settings of the illustrative style.
    pub illustrative: illustrative::Config,
    /// Settings of the pointillism style.
    pub pointillism: pointillism::Config,
    /// Settings of the sketchy style.
    pub sketchy: sketchy::Config,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            name: StyleName::default(),
            fade_ms: 300,
            cycle: Vec::new(),
            anchored: false,
            part: None,
            cartoon: Default::default(),
            bilateral_cartoon: Default::default(),
            sketch_like: Default::default(),
            watercolor: Default::default(),
            illustrative: Default::default(),
            pointillism: Default::default(),
            sketchy: Default::default(),
        }
    }
}

/// Why a style setting is refused.
#[derive(Debug, thiserror::Error, PartialEq)]
pub enum ConfigError {
    /// The style has no such setting.
    #[error("style {style} has no setting {key:?}; did you mean {nearest:?}? (it has: {all})")]
    UnknownKey {
        /// The style.
        style: StyleName,
        /// What was asked for.
        key: String,
        /// The setting with the most similar name.
        nearest: String,
        /// All its settings.
        all: String,
    },
    /// The style has no settings at all.
    #[error("style {style} has no settings, so {key:?} cannot be set")]
    NoSettings {
        /// The style.
        style: StyleName,
        /// What was asked for.
        key: String,
    },
    /// The value is not of the setting's kind.
    #[error("style {style}: {key} = {value:?} does not fit: {reason}")]
    Kind {
        /// The style.
        style: StyleName,
        /// The setting.
        key: String,
        /// What was given.
        value: String,
        /// What is expected.
        reason: String,
    },
    /// The value is outside its range.
    #[error("style {style}: {key} = {value} is out of range: {expected}")]
    Range {
        /// The style.
        style: StyleName,
        /// The setting.
        key: &'static str,
        /// What was given.
        value: f64,
        /// The allowed range.
        expected: &'static str,
    },
    /// A fade lasts too long.
    #[error("style.fade_ms = {0} is out of range: 0 to 5000 ms")]
    Fade(u32),
    /// A setting of the styled part is outside its range.
    #[error(transparent)]
    Part(#[from] RangeError),
}

impl Config {
    /// Checks every setting of every style against its range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        if self.fade_ms > 5000 {
            return Err(ConfigError::Fade(self.fade_ms));
        }
        self.part.map_or(Ok(()), |part| part.validate())?;
        self.cartoon.validate()?;
        self.bilateral_cartoon.validate()?;
        self.sketch_like.validate()?;
        self.watercolor.validate()?;
        self.illustrative.validate()?;
        self.pointillism.validate()?;
        self.sketchy.validate()
    }

    /// Simpler ways to draw the named style, each cheaper than the one before: what a governor steps along. Measured with
    /// `bench --styles`; a setting that is simpler already stays. Empty where nothing is to be gained.
    pub fn simpler(&self) -> Vec<Config> {
        let level = |change: fn(&mut Config)| {
            let mut config = self.clone();
            change(&mut config);
            config
        };
        let mut levels = match self.name {
            StyleName::Plain | StyleName::SketchLike | StyleName::Illustrative => Vec::new(),
            StyleName::Cartoon => vec![
                level(|c| c.cartoon.steps = c.cartoon.steps.min(3)),
                level(|c| {
                    c.cartoon.steps = c.cartoon.steps.min(3);
                    // half of what 480 rows are shrunk to, and never more than 240 rows are
                    if c.cartoon.shrunk_height == 0 || c.cartoon.shrunk_height > 90 {
                        (c.cartoon.shrunk_width, c.cartoon.shrunk_height) = (0, 90);
                    }
                }),
            ],
            StyleName::BilateralCartoon => vec![
                level(|c| c.bilateral_cartoon.iterations = c.bilateral_cartoon.iterations.min(1)),
                level(|c| {
                    c.bilateral_cartoon.iterations = c.bilateral_cartoon.iterations.min(1);
                    c.bilateral_cartoon.levels = c.bilateral_cartoon.levels.max(3);
                }),
            ],
            StyleName::Watercolor => vec![
                level(|c| c.watercolor.retile_every = c.watercolor.retile_every.max(3)),
                level(|c| {
                    c.watercolor.retile_every = c.watercolor.retile_every.max(10);
                    c.watercolor.cell = c.watercolor.cell.max(12);
                }),
            ],
            StyleName::Pointillism => vec![
                level(|c| {
                    c.pointillism.col_skip = c.pointillism.col_skip.max(6);
                    c.pointillism.row_skip = c.pointillism.row_skip.max(6);
                }),
                level(|c| {
                    c.pointillism.col_skip = c.pointillism.col_skip.max(8);
                    c.pointillism.row_skip = c.pointillism.row_skip.max(8);
                }),
            ],
            StyleName::Sketchy => vec![
                level(|c| c.sketchy.density = c.sketchy.density.min(0.06)),
                level(|c| {
                    c.sketchy.density = c.sketchy.density.min(0.04);
                    c.sketchy.points = c.sketchy.points.min(6);
                }),
            ],
        };
        // what changes nothing is no level
        levels.retain(|level| level != self);
        levels.dedup();
        levels
    }

    /// The settings of a style with their defaults, as `key=value` in order of the name.
    pub fn defaults_of(style: StyleName) -> Vec<String> {
        let table = toml::Table::try_from(Config::default()).unwrap_or_default();
        let settings = table.get(style.name()).and_then(toml::Value::as_table);
        // a 32-bit number as it was written, not with the digits it gained
        let short = |value: &toml::Value| match value {
            toml::Value::Float(v) if f64::from(*v as f32) == *v => (*v as f32).to_string(),
            value => value.to_string(),
        };
        settings.into_iter().flatten().map(|(key, value)| format!("{key}={}", short(value))).collect()
    }

    /// Sets one setting of the named style from text, as `--set key=value` does.
    pub fn set(&mut self, key: &str, value: &str) -> Result<(), ConfigError> {
        match self.name {
            StyleName::Plain => Err(ConfigError::NoSettings { style: self.name, key: key.into() }),
            StyleName::Cartoon => {
                self.cartoon = edited(self.name, &self.cartoon, key, value)?;
                self.cartoon.validate()
            }
            StyleName::BilateralCartoon => {
                self.bilateral_cartoon = edited(self.name, &self.bilateral_cartoon, key, value)?;
                self.bilateral_cartoon.validate()
            }
            StyleName::SketchLike => {
                self.sketch_like = edited(self.name, &self.sketch_like, key, value)?;
                self.sketch_like.validate()
            }
            StyleName::Watercolor => {
                self.watercolor = edited(self.name, &self.watercolor, key, value)?;
                self.watercolor.validate()
            }
            StyleName::Illustrative => {
                self.illustrative = edited(self.name, &self.illustrative, key, value)?;
                self.illustrative.validate()
            }
            StyleName::Pointillism => {
                self.pointillism = edited(self.name, &self.pointillism, key, value)?;
                self.pointillism.validate()
            }
            StyleName::Sketchy => {
                self.sketchy = edited(self.name, &self.sketchy, key, value)?;
                self.sketchy.validate()
            }
        }
    }
}

/// `settings` with `key` set to `value`, by way of the same serde form that files use.
fn edited<T>(style: StyleName, settings: &T, key: &str, value: &str) -> Result<T, ConfigError>
where
    T: Serialize + serde::de::DeserializeOwned,
{
    let kind = |reason: String| ConfigError::Kind { style, key: key.into(), value: value.into(), reason };
    let mut table = toml::Table::try_from(settings).map_err(|e| kind(e.to_string()))?;
    if !table.contains_key(key) {
        let nearest =
            table.keys().min_by_key(|known| strsim::levenshtein(known, key)).cloned().unwrap_or_default();
        let all = table.keys().cloned().collect::<Vec<_>>().join(" ");
        return Err(ConfigError::UnknownKey { style, key: key.into(), nearest, all });
    }
    table.insert(key.into(), parsed(value));
    table.try_into().map_err(|e: toml::de::Error| kind(e.message().to_string()))
}

/// A number or a truth value where the text reads as one, else the text itself.
fn parsed(value: &str) -> toml::Value {
    if let Ok(number) = value.parse::<i64>() {
        toml::Value::Integer(number)
    } else if let Ok(number) = value.parse::<f64>() {
        toml::Value::Float(number)
    } else if let Ok(truth) = value.parse::<bool>() {
        toml::Value::Boolean(truth)
    } else {
        toml::Value::String(value.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_reached_by_name() {
        let mut config = Config::default();
        config.set("sigma_p", ".05").expect("a number");
        config.set("steps", "3").expect("an integer");
        config.set("alpha", "1").expect("an integer is a number");
        assert_eq!((config.cartoon.sigma_p, config.cartoon.steps, config.cartoon.alpha), (0.05, 3, 1.0));
        let file: Config =
            toml::from_str("name = 'cartoon'\n[cartoon]\nsigma_p = 0.05\nsteps = 3\nalpha = 1")
                .expect("the same in a file");
        assert_eq!(file, config);
    }

    #[test]
    fn refusals_name_the_setting() {
        let mut config = Config::default();
        let error = config.set("sigmap", "1").expect_err("no such key").to_string();
        assert!(error.contains("\"sigma_p\""), "{error}");
        for (key, value) in
            [("steps", "many"), ("steps", "-1"), ("alpha", "1.5"), ("sigma_p", "0"), ("s0", "nan")]
        {
            let error = Config::default().set(key, value).expect_err(value).to_string();
            assert!(error.contains(key), "{error}");
        }
        let error = Config::default().set("s0", "0.5").expect_err("s0 >= s1").to_string();
        assert!(error.contains("s1"), "{error}");
        config.name = StyleName::Plain;
        assert!(config.set("alpha", "1").expect_err("plain").to_string().contains("no settings"));
        assert!(toml::from_str::<Config>("nme = 'plain'").is_err());
        let long: Config = toml::from_str("fade_ms = 6000").expect("a number");
        assert!(long.validate().expect_err("too long").to_string().contains("fade_ms = 6000"));
    }

    #[test]
    fn every_default_may_be_set() {
        use clap::ValueEnum;
        for &name in StyleName::value_variants() {
            let settings = Config::defaults_of(name);
            assert_eq!(settings.is_empty(), name == StyleName::Plain, "{name}");
            let mut config = Config { name, ..Config::default() };
            for setting in &settings {
                let (key, value) = setting.split_once('=').expect("key=value");
                config.set(key, value.trim_matches('"')).expect(setting);
            }
            assert_eq!(config, Config { name, ..Config::default() });
        }
    }

    #[test]
    fn simpler_levels_are_valid_and_end_somewhere() {
        use clap::ValueEnum;
        for &name in StyleName::value_variants() {
            let config = Config { name, ..Config::default() };
            let levels = config.simpler();
            assert_eq!(levels.len(), if name.is_simple() { 0 } else { 2 }, "{name}");
            assert!(levels.iter().all(|level| level.validate().is_ok() && level.name == name));
            let last = levels.last().unwrap_or(&config);
            assert!(last.simpler().is_empty(), "{name}");
        }
    }

    #[test]
    fn names_agree_everywhere() {
        use clap::ValueEnum;
        for &style in StyleName::value_variants() {
            assert_eq!(style.to_possible_value().expect("not hidden").get_name(), style.name());
            assert_eq!(toml::Value::try_from(style).expect("a string").as_str(), Some(style.name()));
        }
    }
}
