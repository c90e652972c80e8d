//! `vernissage probe`: what the machine has that the visor could use.

use super::config::Loaded;
use super::machine::{self, Access, access, holders};
use super::report::{VERSION, processor};
use super::say;
use crate::camera;
use crate::pixels::simd;
use std::path::PathBuf;

/// Lists cameras, screens, serial ports and what the machine can compute with.
///
/// Cameras with their formats and sizes in the order in which the visor would take them, and why; screens with their
/// modes; serial ports; processor, SIMD level, cores, clock and temperatures. Nothing is streamed or drawn.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  vernissage probe\n  vernissage probe --config visor.toml --json")]
pub struct Args {
    /// Visor file whose [camera] says what is wished; without: 640x480, 30 pictures a second
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Offers of a camera that are listed, the best first
    #[arg(long, default_value_t = 8, value_name = "N")]
    offers: usize,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

pub fn run(args: Args) -> anyhow::Result<()> {
    let wished = match &args.config {
        Some(path) => Loaded::read(path)?.config.camera,
        None => camera::Config::default(),
    };
    if args.json { say(json(&wished, args.offers)) } else { print(&wished, args.offers) }
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, usize::from)
}

fn print(wished: &camera::Config, most: usize) -> anyhow::Result<()> {
    say(format_args!("vernissage {VERSION}"))?;
    say(format_args!("processor   {}, {} cores, {}", processor(), cores(), simd::name(simd::best())))?;
    if let Some((now, most)) = machine::clock_mhz() {
        say(format_args!("clock       {now} MHz of {most}"))?;
    }
    for zone in machine::thermal() {
        let passive = zone.passive.map(|c| format!(", slows down from {c:.0} °C")).unwrap_or_default();
        say(format_args!("heat        {} {:.0} °C{passive}", zone.name, zone.celsius))?;
    }
    let cameras = cameras(wished);
    say(format_args!("\ncameras{}", if cameras.is_empty() { "     none (/dev/video*)" } else { "" }))?;
    for camera in &cameras {
        let usb =
            machine::usb_of(&camera.path).map(|(speed, bus)| format!(", USB bus {bus}, {speed} Mbit/s"));
        let name = if camera.card.is_empty() { String::new() } else { format!(" {}", camera.card) };
        say(format_args!("  {}{name}{}", camera.path.display(), usb.unwrap_or_default()))?;
        if let Some(refusal) = &camera.refusal {
            say(format_args!("    not usable: {refusal}"))?;
        }
        for (k, ranked) in camera.offers.iter().take(most).enumerate() {
            say(format_args!("    {:>2}. {}", k + 1, ranked.reason))?;
        }
        if camera.offers.len() > most {
            say(format_args!("    and {} more (--offers)", camera.offers.len() - most))?;
        }
    }
    let cards = machine::cards();
    say(format_args!("\nscreens{}", if cards.is_empty() { "     none (/dev/dri/card*)" } else { "" }))?;
    for card in &cards {
        say(format_args!("  {} {}{}", card.path.display(), card.driver, rights(access(&card.path))))?;
        for socket in &card.connectors {
            let state = match socket.connected {
                Some(true) => format!("connected: {}", socket.modes.join(" ")),
                Some(false) => "nothing plugged in".into(),
                None => "not told".into(),
            };
            say(format_args!("    {} {state}", socket.name))?;
        }
    }
    let ports = machine::serial_ports();
    say(format_args!("\nserial ports{}", if ports.is_empty() { " none" } else { "" }))?;
    for (path, what) in &ports {
        say(format_args!("  {} {what}{}", path.display(), rights(access(path))))?;
    }
    Ok(())
}

fn rights(access: Access) -> &'static str {
    match access {
        Access::Granted => "",
        Access::Missing => ", no node",
        Access::Denied => ", no right to open it",
    }
}

/// Every video node.
pub fn cameras(wished: &camera::Config) -> Vec<camera::Candidate> {
    camera::probe(wished)
}

fn json(wished: &camera::Config, most: usize) -> serde_json::Value {
    let cameras: Vec<_> = cameras(wished)
        .iter()
        .map(|camera| {
            let offers = camera.offers.iter().take(most).map(|ranked| {
                serde_json::json!({
                    "format": ranked.offer.format.name(), "width": ranked.offer.size.width,
                    "height": ranked.offer.size.height, "fps": ranked.offer.fps, "reason": ranked.reason,
                })
            });
            serde_json::json!({
                "path": camera.path, "name": camera.card, "driver": camera.driver, "refusal": camera.refusal,
                "usb_mbit": machine::usb_of(&camera.path).map(|usb| usb.0), "offers": offers.collect::<Vec<_>>(),
                "open_in": holders(&camera.path).iter().map(ToString::to_string).collect::<Vec<_>>(),
            })
        })
        .collect();
    let screens: Vec<_> = machine::cards()
        .iter()
        .map(|card| {
            let connectors: Vec<_> = card
                .connectors
                .iter()
                .map(|c| serde_json::json!({ "name": c.name, "connected": c.connected, "modes": c.modes }))
                .collect();
            let may_open = access(&card.path) == Access::Granted;
            serde_json::json!({
                "path": card.path, "driver": card.driver, "connectors": connectors, "may_open": may_open,
            })
        })
        .collect();
    let ports: Vec<_> = machine::serial_ports()
        .iter()
        .map(|(path, what)| {
            serde_json::json!({ "path": path, "what": what, "may_open": access(path) == Access::Granted })
        })
        .collect();
    let heat: Vec<_> = machine::thermal()
        .iter()
        .map(|zone| serde_json::json!({ "name": zone.name, "celsius": zone.celsius, "slows_from": zone.passive }))
        .collect();
    serde_json::json!({
        "version": VERSION, "processor": processor(), "cores": cores(), "simd": simd::name(simd::best()),
        "clock_mhz": machine::clock_mhz().map(|(now, most)| [now, most]), "thermal": heat, "cameras": cameras,
        "screens": screens, "serial_ports": ports,
    })
}
