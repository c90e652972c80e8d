//! The display's settings: the `[display]` table of the visor file.

use super::{Layout, Rotate};
use crate::pixels::Size;
use serde::Deserialize;
use std::path::PathBuf;

/// Settings of the display.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Config {
    /// `"kms"` (a kernel display, the default), `"window"` (on a desktop), `"y4m"` (a clip), `"png"` (a folder of
    /// pictures) or `"null"`.
    pub sink: Kind,
    /// The clip's file (`-` is stdout) or the pictures' folder.
    pub path: Option<PathBuf>,
    /// `"auto"` (the first card with a connected screen) or a node such as `"/dev/dri/card0"`.
    pub card: String,
    /// Wanted mode, `"WIDTHxHEIGHT"` in pixels. Without it: the canvas's size where the screen has it, else
    /// the screen's preferred mode. Of a window the size at first.
    pub mode: Option<ModeSize>,
    /// `"one-to-one"` (the default: centered, black around it, cropped where it is larger than the screen) or
    /// `"fit"` (as large as it goes, proportions kept, black around it).
    pub scale: Scale,
    /// How `"fit"` samples: `"bilinear"` (the default) or `"nearest"`.
    pub filter: Filter,
    /// Turns the picture clockwise: 0 (the default), 90, 180 or 270 degrees; for screens built in the other way.
    pub rotate: Rotate,
    /// Whether left and right change places, after turning: for screens seen in a mirror. Default false.
    pub mirror: bool,
    /// Whether the picture is shown twice side by side, for visors with two lenses. Default false.
    pub stereo: bool,
    /// Frames per second written into a clip's header, 1 or more.
    pub fps: u32,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            sink: Kind::Kms,
            path: None,
            card: "auto".into(),
            mode: None,
            scale: Scale::default(),
            filter: Filter::default(),
            rotate: Rotate::default(),
            mirror: false,
            stereo: false,
            fps: 30,
        }
    }
}

impl Config {
    /// Where every pixel of the canvas goes. Files hold the canvas as it is.
    pub fn layout(&self) -> Layout {
        let &Self { scale, filter, rotate, mirror, stereo, .. } = self;
        Layout { scale, filter, rotate, mirror, stereo }
    }
}

/// Which sink.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A kernel display.
    Kms,
    /// A window on a desktop.
    Window,
    /// One Y4M clip.
    Y4m,
    /// A folder of PNG files.
    Png,
    /// Nowhere.
    Null,
}

/// How the canvas is put on a screen of another size.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scale {
    /// Pixel for pixel, centered, black around it; a larger canvas loses its borders.
    #[default]
    OneToOne,
    /// As large as it goes with its proportions, centered, black around it.
    Fit,
}

/// How a scaled canvas is sampled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Filter {
    /// The pixel whose area holds the sample point.
    Nearest,
    /// Bilinear between pixel centers, clamped at the border.
    #[default]
    Bilinear,
}

/// A mode's size as written in settings: `"640x480"`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(try_from = "String")]
pub struct ModeSize(pub Size);

impl TryFrom<String> for ModeSize {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        let side = |s: &str| s.parse::<usize>().ok().filter(|n| (1..=16384).contains(n));
        let sides = text.split_once('x').and_then(|(w, h)| Some((side(w)?, side(h)?)));
        let (w, h) =
            sides.ok_or_else(|| format!("mode {text:?}: write WIDTHxHEIGHT, such as \"640x480\""))?;
        Ok(Self(Size::new(w, h)))
    }
}
