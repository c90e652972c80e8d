//! Finding the screen: the first card with dumb buffers and a connected connector, and the mode to drive it in.

use super::{Config, DisplayError};
use crate::pixels::Size;
use drm::Device as _;
use drm::control::{Device as _, Mode, ModeTypeFlags, connector, crtc};
use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind};
use std::os::fd::{AsFd, BorrowedFd};
use std::path::{Path, PathBuf};

const FOLDER: &str = "/dev/dri";

/// An open card.
#[derive(Debug)]
pub(super) struct Card {
    file: File,
    pub(super) path: PathBuf,
}

impl AsFd for Card {
    fn as_fd(&self) -> BorrowedFd<'_> {
        self.file.as_fd()
    }
}

impl drm::Device for Card {}
impl drm::control::Device for Card {}

/// A card, its connector, the CRTC that can feed it and the chosen mode.
#[derive(Debug)]
pub(super) struct Screen {
    pub(super) card: Card,
    pub(super) connector: connector::Handle,
    /// Such as `HDMI-A-1`.
    pub(super) name: String,
    pub(super) crtc: crtc::Handle,
    pub(super) mode: Mode,
}

impl Screen {
    /// Looks at the card that the settings name, or at all of them in the order of their numbers.
    pub(super) fn find(config: &Config, canvas: Size) -> Result<Self, DisplayError> {
        let cards = match config.card.as_str() {
            "auto" => all_cards()?,
            named => vec![named.into()],
        };
        let mut looked = Vec::new();
        for path in cards {
            match Self::on_card(&path, config, canvas) {
                Ok(screen) => return Ok(screen),
                Err(reason) => looked.push(format!("{}: {reason}", path.display())),
            }
        }
        Err(DisplayError::NoDisplay { looked: looked.join("; ") })
    }

    /// The first connected screen of one card, or why there is none.
    fn on_card(path: &Path, config: &Config, canvas: Size) -> Result<Self, String> {
        // opening makes us the card's master when nobody is; nothing more is forced
        let file = OpenOptions::new().read(true).write(true).open(path).map_err(|e| open_reason(&e))?;
        let card = Card { file, path: path.into() };
        let dumb = card.get_driver_capability(drm::DriverCapability::DumbBuffer);
        if dumb.map_err(|e| format!("not a display card ({e})"))? == 0 {
            return Err("the driver has no dumb buffers".into());
        }
        let resources = card.resource_handles().map_err(|e| format!("has no screens ({e})"))?;
        let mut seen = Vec::new();
        for &handle in resources.connectors() {
            let Ok(connector) = card.get_connector(handle, true) else { continue };
            let name = format!("{}-{}", connector.interface().as_str(), connector.interface_id());
            if connector.state() != connector::State::Connected {
                seen.push(format!("{name} is not connected"));
                continue;
            }
            let Some(mode) = choose_mode(connector.modes(), config.mode.map(|m| m.0), canvas) else {
                seen.push(match config.mode {
                    Some(wanted) => {
                        format!("{name} has no mode {}, only {}", wanted.0, list(connector.modes()))
                    }
                    None => format!("{name} reports no mode"),
                });
                continue;
            };
            let Some(crtc) = crtc_of(&card, &resources, &connector) else {
                seen.push(format!("{name} has no free CRTC"));
                continue;
            };
            return Ok(Self { connector: handle, name, crtc, mode, card });
        }
        Err(if seen.is_empty() { "no connectors".into() } else { seen.join(", ") })
    }
}

fn all_cards() -> Result<Vec<PathBuf>, DisplayError> {
    let none = |reason: String| DisplayError::NoDisplay { looked: format!("{FOLDER}: {reason}") };
    let entries = std::fs::read_dir(FOLDER).map_err(|e| none(open_reason(&e)))?;
    let number = |path: &Path| path.file_name()?.to_str()?.strip_prefix("card")?.parse::<u32>().ok();
    let mut cards: Vec<_> = entries.flatten().filter_map(|e| Some((number(&e.path())?, e.path()))).collect();
    cards.sort();
    if cards.is_empty() {
        return Err(none("no card in it".into()));
    }
    Ok(cards.into_iter().map(|(_, path)| path).collect())
}

fn open_reason(error: &Error) -> String {
    match error.kind() {
        ErrorKind::NotFound => "not there".into(),
        ErrorKind::PermissionDenied => "permission denied (join the group video)".into(),
        _ => error.to_string(),
    }
}

/// The wanted size where it is wanted, else the canvas's own size, else what the screen prefers. Of several
/// modes of a size the preferred one, else the first: kernels list the best first.
fn choose_mode(modes: &[Mode], wanted: Option<Size>, canvas: Size) -> Option<Mode> {
    let preferred = |mode: &&Mode| mode.mode_type().contains(ModeTypeFlags::PREFERRED);
    let of = |size: Size| {
        let fits = move |mode: &&Mode| mode_size(mode) == size;
        modes.iter().filter(fits).find(preferred).or_else(|| modes.iter().find(fits))
    };
    let best = match wanted {
        Some(size) => of(size),
        None => of(canvas).or_else(|| modes.iter().find(preferred)).or_else(|| modes.first()),
    };
    best.copied()
}

pub(super) fn mode_size(mode: &Mode) -> Size {
    let (width, height) = mode.size();
    Size::new(width.into(), height.into())
}

fn list(modes: &[Mode]) -> String {
    let mut sizes: Vec<_> = modes.iter().map(|mode| mode_size(mode).to_string()).collect();
    sizes.dedup();
    sizes.join(" ")
}

/// The CRTC that feeds the connector already, else the first that can.
fn crtc_of(
    card: &Card,
    resources: &drm::control::ResourceHandles,
    connector: &connector::Info,
) -> Option<crtc::Handle> {
    let current = connector.current_encoder().and_then(|e| card.get_encoder(e).ok()?.crtc());
    let possible = || {
        let encoders = connector.encoders().iter().filter_map(|&e| card.get_encoder(e).ok());
        encoders.flat_map(|e| resources.filter_crtcs(e.possible_crtcs())).next()
    };
    current.or_else(possible)
}
