//! A window on a desktop (X11): for looking at a scene where the screen belongs to somebody else.
//!
//! A thread of its own speaks with the X server. One picture at a time is handed over and put into the window; one that
//! comes before the last was taken is not shown, as on a screen that has not flipped yet. So a server that is slow, or
//! stands still, never holds the frame loop. Plain requests, no shared memory: that works over a network as well. The
//! window may be made larger or smaller: the pictures after that are composed for its new size.

use super::{Composer, Config, DisplayError, Layout, Shown, Xrgb};
use crate::frame::now;
use crate::pixels::{Rgb, Size};
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TryRecvError, sync_channel};
use std::sync::{Arc, OnceLock};
use std::time::Duration;
use x11rb::connection::{Connection as _, RequestConnection as _};
use x11rb::errors::ReplyError;
use x11rb::protocol::Event;
use x11rb::protocol::xproto::{
    AtomEnum, ChangeWindowAttributesAux, ColormapAlloc, ConnectionExt as _, CreateGCAux, CreateWindowAux,
    EventMask, Gcontext, ImageFormat, ImageOrder, Pixmap, PropMode, Screen, Setup, VisualClass, Visualid,
    WindowClass,
};
use x11rb::rust_connection::RustConnection;
use x11rb::wrapper::ConnectionExt as _;

/// A server takes a picture in a few milliseconds; one that has had no time for any for so long is stuck.
const PATIENCE: Duration = Duration::from_secs(5);
/// How often the window's keys and border are looked at while no picture comes.
const PAUSE: Duration = Duration::from_millis(50);
/// Bits of a pixel that tell a color; a pixel has 32.
const DEPTH: u8 = 24;
/// Bytes of a request that are not the picture's, at most.
const HEADER: usize = 64;
/// The keys that close the window: Escape and q.
const CLOSING: [u32; 2] = [0xff1b, 0x71];

/// An open window.
#[derive(Debug)]
pub struct Window {
    name: String,
    layout: Layout,
    composer: Composer,
    size: Size,
    /// The picture's memory, when the server has taken the one before.
    taken: Receiver<Taken>,
    pictures: SyncSender<Picture>,
    /// Why the window is no more, as soon as it is: nothing where somebody closed it.
    end: Arc<OnceLock<Option<String>>>,
    /// Since when pictures come that the server has no time for.
    late: Option<Duration>,
    dropped: u64,
}

/// XRGB8888, as [`Xrgb`].
#[derive(Debug)]
struct Picture {
    bytes: Vec<u8>,
    size: Size,
}

/// What the thread gives back.
#[derive(Debug)]
struct Taken {
    picture: Picture,
    /// When the server had shown it.
    at: Option<Duration>,
    /// The window's size now.
    window: Size,
}

impl Window {
    /// Opens a window of the mode's size, or of the canvas's, on the X server that the environment names (`DISPLAY`).
    pub fn open(config: &Config, canvas: Size) -> Result<Self, DisplayError> {
        let layout = config.layout();
        let size = config.mode.map_or(layout.mode(canvas), |mode| mode.0);
        let refused = |why: String| DisplayError::NoWindow { why };
        let server = std::env::var("DISPLAY").ok().filter(|name| !name.is_empty());
        let server = server.ok_or_else(|| refused("DISPLAY names no X server".into()))?;
        let desk = Desk::open(size).map_err(|why| refused(format!("X server {server}: {why}")))?;

        let (give, taken) = sync_channel(1);
        let (pictures, come) = sync_channel(1);
        let end = Arc::<OnceLock<_>>::default();
        let picture = Picture { bytes: Vec::new(), size };
        // the first is there to be filled
        let _ = give.try_send(Taken { picture, at: None, window: size });
        let told = end.clone();
        let thread = std::thread::Builder::new().name("window".into());
        let work = move || {
            let ended = desk.serve(&come, &give);
            // before the channels close
            let _ = told.set(ended.err().map(|error| error.to_string()));
        };
        thread.spawn(work).map_err(|error| refused(format!("no thread for it: {error}")))?;
        Ok(Self {
            name: format!("a window of {server}"),
            layout,
            composer: Composer::new(size, layout),
            size,
            taken,
            pictures,
            end,
            late: None,
            dropped: 0,
        })
    }

    /// Composes one picture and hands it over; see [`super::Sink::present`]. Not shown where the one before is not yet
    /// taken.
    pub fn present(&mut self, canvas: &Rgb) -> Result<Shown, DisplayError> {
        self.check()?;
        let Taken { mut picture, at, window } = match self.taken.try_recv() {
            Ok(taken) => taken,
            Err(TryRecvError::Disconnected) => return self.check().and(Err(DisplayError::Closed)),
            Err(TryRecvError::Empty) => {
                let at = now();
                if at >= *self.late.get_or_insert(at) + PATIENCE {
                    return Err(DisplayError::WindowLost { why: "the X server takes no pictures".into() });
                }
                self.dropped += 1;
                return Ok(Shown { at, previous: None });
            }
        };
        // the picture of the call before this one, unless that was not shown
        let previous = at.filter(|_| self.late.is_none());
        self.late = None;
        if window != self.size {
            (self.size, self.composer) = (window, Composer::new(window, self.layout));
        }
        picture.take(self.composer.compose(canvas));
        // there is room: it was taken out. A thread that has ended meanwhile is found out about with the next picture
        let _ = self.pictures.try_send(picture);
        Ok(Shown { at: now(), previous })
    }

    /// See [`super::Sink::check`].
    pub fn check(&self) -> Result<(), DisplayError> {
        match self.end.get() {
            None => Ok(()),
            Some(None) => Err(DisplayError::Closed),
            Some(Some(why)) => Err(DisplayError::WindowLost { why: why.clone() }),
        }
    }

    /// Width and height.
    pub fn mode(&self) -> Size {
        self.size
    }

    /// Pictures that were not shown because the one before was not yet taken.
    pub fn dropped(&self) -> u64 {
        self.dropped
    }
}

impl std::fmt::Display for Window {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}, {}", self.name, self.size)
    }
}

impl Picture {
    fn take(&mut self, image: &Xrgb) {
        self.size = image.size();
        self.bytes.clear();
        image.rows().for_each(|row| self.bytes.extend_from_slice(row));
    }
}

/// The window as the server knows it.
struct Desk {
    server: RustConnection,
    window: u32,
    /// What the window shows; the server paints it again when the window was covered.
    ground: Pixmap,
    context: Gcontext,
    size: Size,
    /// The picture in `ground`.
    filled: Size,
    /// Bytes of a request at most.
    most: usize,
    closes: u32,
    closing: Vec<u8>,
}

/// Why the server does not do what we ask.
type Refusal = Box<dyn std::error::Error + Send + Sync>;

impl Desk {
    /// Makes the window.
    fn open(size: Size) -> Result<Self, Refusal> {
        let (server, number) = RustConnection::connect(None)?;
        let screen = server.setup().roots.get(number).ok_or("it has no such screen")?;
        let visual =
            visual(server.setup(), screen).ok_or("no visual of it has 8 bits each of red, green and blue")?;
        let (window, colors, context) = (server.generate_id()?, server.generate_id()?, server.generate_id()?);
        server.create_colormap(ColormapAlloc::NONE, colors, screen.root, visual)?;
        let look = CreateWindowAux::new()
            .background_pixel(0)
            .border_pixel(0)
            .colormap(colors)
            .event_mask(EventMask::STRUCTURE_NOTIFY | EventMask::KEY_PRESS);
        let (width, height) = sides(size);
        let kind = WindowClass::INPUT_OUTPUT;
        server
            .create_window(DEPTH, window, screen.root, 0, 0, width, height, 0, kind, visual, &look)?
            .check()?;
        server.create_gc(context, window, &CreateGCAux::new().graphics_exposures(0))?.check()?;
        let atom = |name: &str| Ok::<_, Refusal>(server.intern_atom(false, name.as_bytes())?.reply()?.atom);
        let (protocols, closes) = (atom("WM_PROTOCOLS")?, atom("WM_DELETE_WINDOW")?);
        server.change_property32(PropMode::REPLACE, window, protocols, AtomEnum::ATOM, &[closes])?;
        for (name, text) in
            [(AtomEnum::WM_NAME, &b"vernissage"[..]), (AtomEnum::WM_CLASS, b"vernissage\0vernissage\0")]
        {
            server.change_property8(PropMode::REPLACE, window, name, AtomEnum::STRING, text)?;
        }
        let closing = closing(&server)?;
        server.map_window(window)?.check()?;
        let (ground, most) = (x11rb::NONE, server.maximum_request_bytes());
        Ok(Self { window, ground, context, size, filled: Size::default(), most, closes, closing, server })
    }

    /// Shows what comes until the window is closed or the sink is gone.
    fn serve(mut self, come: &Receiver<Picture>, give: &SyncSender<Taken>) -> Result<(), Refusal> {
        loop {
            match come.recv_timeout(PAUSE) {
                Ok(picture) => {
                    self.put(&picture)?;
                    let at = Some(now());
                    // there is room: it was taken out
                    let _ = give.try_send(Taken { picture, at, window: self.size });
                }
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Ok(()),
            }
            while let Some(event) = self.server.poll_for_event()? {
                match event {
                    Event::ConfigureNotify(event) => {
                        self.size = Size::new(event.width.into(), event.height.into());
                    }
                    Event::ClientMessage(event) if event.data.as_data32()[0] == self.closes => return Ok(()),
                    Event::KeyPress(event) if self.closing.contains(&event.detail) => return Ok(()),
                    Event::DestroyNotify(_) => return Ok(()),
                    Event::Error(error) => return Err(ReplyError::from(error).into()),
                    _ => {}
                }
            }
        }
    }

    /// Puts a picture into the window; returns when the server has done it.
    fn put(&mut self, picture: &Picture) -> Result<(), Refusal> {
        let (server, window) = (&self.server, self.window);
        let (width, height) = sides(picture.size);
        if picture.size != self.filled {
            if self.ground != x11rb::NONE {
                server.free_pixmap(self.ground)?;
            }
            self.ground = server.generate_id()?;
            server.create_pixmap(DEPTH, self.ground, window, width, height)?;
            self.filled = picture.size;
        }
        let pitch = usize::from(width) * 4;
        let rows = (self.most.saturating_sub(HEADER) / pitch).max(1);
        let mut top = 0;
        for band in picture.bytes.chunks(rows * pitch) {
            let high = (band.len() / pitch) as u16;
            let (format, ground) = (ImageFormat::Z_PIXMAP, self.ground);
            server.put_image(format, ground, self.context, width, high, 0, top as i16, 0, DEPTH, band)?;
            top += high;
        }
        let look = ChangeWindowAttributesAux::new().background_pixmap(self.ground);
        server.change_window_attributes(window, &look)?;
        server.clear_area(false, window, 0, 0, 0, 0)?;
        // an answer comes when all of that is done
        server.get_input_focus()?.reply()?;
        Ok(())
    }
}

/// The codes of the keys that close the window.
fn closing(server: &RustConnection) -> Result<Vec<u8>, Refusal> {
    let (first, last) = (server.setup().min_keycode, server.setup().max_keycode);
    let keys = server.get_keyboard_mapping(first, last.saturating_sub(first).saturating_add(1))?.reply()?;
    let codes = (first..=last).zip(keys.keysyms.chunks(keys.keysyms_per_keycode.max(1).into()));
    Ok(codes.filter(|(_, key)| CLOSING.contains(&key[0])).map(|(code, _)| code).collect())
}

/// Pixels that are ours byte for byte: blue, green, red, nothing.
fn visual(setup: &Setup, screen: &Screen) -> Option<Visualid> {
    let wide = setup.pixmap_formats.iter().any(|format| format.depth == DEPTH && format.bits_per_pixel == 32);
    if !wide || setup.image_byte_order != ImageOrder::LSB_FIRST {
        return None;
    }
    let visuals = screen.allowed_depths.iter().filter(|depth| depth.depth == DEPTH).flat_map(|d| &d.visuals);
    let ours = [0xff_0000, 0xff00, 0xff];
    let mut ours = visuals.filter(|visual| {
        visual.class == VisualClass::TRUE_COLOR
            && [visual.red_mask, visual.green_mask, visual.blue_mask] == ours
    });
    ours.next().map(|visual| visual.visual_id)
}

/// Of at least a pixel; settings and servers have no larger ones than fit.
fn sides(size: Size) -> (u16, u16) {
    let side = |length: usize| length.clamp(1, i16::MAX as usize) as u16;
    (side(size.width), side(size.height))
}
