//! A kernel display: three dumb buffers on one CRTC, shown by page flips.
//!
//! One buffer is on the screen, one may be waiting for its flip, one is free to be written: a picture is never
//! seen half drawn, and writing never waits for the screen. A flip's event may never come (an unplugged
//! cable, a sleeping screen): after a time-out we count it, and `flips` says how to go on. What the screen showed before
//! is put back when the sink is dropped.

use super::card::{Card, Screen, mode_size};
use super::flips::{Flips, Next};
use super::xrgb::Hash;
use super::{Composer, Config, DisplayError, Shown, Xrgb};
use crate::frame::now;
use crate::pixels::{Rgb, Size};
use drm::Device as _;
use drm::buffer::{Buffer as _, DrmFourcc};
use drm::control::connector::State;
use drm::control::dumbbuffer::{DumbBuffer, DumbMapping};
use drm::control::{Device as _, Event, PageFlipFlags, crtc, framebuffer};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use std::io::{Error, ErrorKind};
use std::time::Duration;

/// How long a flip may take: several periods of the slowest screen.
const FLIP_TIMEOUT: Duration = Duration::from_millis(100);

/// An open kernel display.
pub struct Kms {
    screen: Screen,
    before: Option<crtc::Info>,
    composer: Composer,
    buffers: Vec<ScanOut>,
    /// Buffer on the screen.
    front: usize,
    /// Buffer whose flip has been asked for and has not been seen to end.
    pending: Option<usize>,
    /// When the front buffer came on the screen, until `present` has told.
    flipped_at: Option<Duration>,
    flips: Flips,
}

/// One scan-out buffer.
struct ScanOut {
    buffer: DumbBuffer,
    framebuffer: Option<framebuffer::Handle>,
    /// `None` only while dropping.
    map: Option<DumbMapping<'static>>,
}

impl Kms {
    /// Finds the screen, sets its mode and shows black.
    pub fn open(config: &Config, canvas: Size) -> Result<Self, DisplayError> {
        let screen = Screen::find(config, config.layout().mode(canvas))?;
        // who else has it is told before anything is made for it: a screen in other hands is asked for again and again
        if let Err(error) = screen.card.acquire_master_lock()
            && matches!(error.kind(), ErrorKind::PermissionDenied | ErrorKind::ResourceBusy)
        {
            return Err(DisplayError::Owned { card: screen.card.path.clone() });
        }
        let size = mode_size(&screen.mode);
        let before = screen.card.get_crtc(screen.crtc).ok();
        let mut kms = Self {
            composer: Composer::new(size, config.layout()),
            screen,
            before,
            buffers: Vec::with_capacity(3),
            front: 0,
            pending: None,
            flipped_at: None,
            flips: Flips::default(),
        };
        for _ in 0..3 {
            let buffer = kms.make_buffer(size)?;
            kms.buffers.push(buffer);
        }
        kms.show_front()?;
        Ok(kms)
    }

    fn make_buffer(&self, size: Size) -> Result<ScanOut, DisplayError> {
        let card = &self.screen.card;
        let wide = (size.width as u32, size.height as u32);
        let buffer = card
            .create_dumb_buffer(wide, DrmFourcc::Xrgb8888, 32)
            .map_err(|e| refused(card, "make a scan-out buffer", e))?;
        // The mapping borrows the buffer's description for as long as it lives, and it lives as long as the
        // sink: forty bytes are given away, once a buffer and opening. The buffer itself is freed on drop.
        let lent: &'static mut DumbBuffer = Box::leak(Box::new(buffer));
        let map = card.map_dumb_buffer(lent).map_err(|e| refused(card, "map a scan-out buffer", e));
        let mut made = ScanOut { buffer, framebuffer: None, map: None };
        let framebuffer = map.and_then(|map| {
            made.map = Some(map);
            card.add_framebuffer(&buffer, 24, 32).map_err(|e| refused(card, "make a framebuffer", e))
        });
        match framebuffer {
            Ok(handle) => made.framebuffer = Some(handle),
            Err(error) => {
                made.free(card);
                return Err(error);
            }
        }
        if let Some(map) = &mut made.map {
            map.fill(0);
        }
        Ok(made)
    }

    /// Sets the mode with the front buffer.
    fn show_front(&mut self) -> Result<(), DisplayError> {
        let Screen { card, crtc, connector, mode, .. } = &self.screen;
        let framebuffer = self.buffers[self.front].framebuffer;
        card.set_crtc(*crtc, framebuffer, (0, 0), &[*connector], Some(*mode))
            .map_err(|e| refused(card, "set the mode", e))
    }

    /// Composes, copies and queues one picture; see [`super::Sink::present`].
    pub fn present(&mut self, canvas: &Rgb) -> Result<Shown, DisplayError> {
        let image = self.composer.compose(canvas);
        let busy = [Some(self.front), self.pending];
        let free = (0..self.buffers.len()).find(|&i| !busy.contains(&Some(i))).unwrap_or(0);
        self.buffers[free].write(image);
        self.wait_for_flip();
        let previous = self.flipped_at.take();
        match self.flips.next() {
            Next::Flip => self.flip(free)?,
            Next::SetMode => {
                self.front = free;
                self.show_front()?;
                self.flips.set();
                self.flipped_at = Some(now());
            }
            Next::GiveUp => return Err(DisplayError::Stuck { card: self.screen.card.path.clone() }),
        }
        Ok(Shown { at: now(), previous })
    }

    fn flip(&mut self, free: usize) -> Result<(), DisplayError> {
        let Screen { card, crtc, .. } = &self.screen;
        let Some(framebuffer) = self.buffers[free].framebuffer else { return Ok(()) };
        match card.page_flip(*crtc, framebuffer, PageFlipFlags::EVENT, None) {
            Ok(()) => {
                self.pending = Some(free);
                self.flips.queued();
            }
            // the last flip's event was lost, or it still waits: this picture is dropped, not the sink
            Err(error) if busy_error(&error) => self.flips.refused(),
            Err(error) => return Err(refused(card, "flip to a picture", error)),
        }
        Ok(())
    }

    /// Waits until no flip is pending, or gives it up.
    fn wait_for_flip(&mut self) {
        let Some(waiting) = self.pending.take() else { return };
        let deadline = now() + FLIP_TIMEOUT;
        let mut ended = None;
        while ended.is_none() && self.readable(deadline.saturating_sub(now())) {
            let Ok(events) = self.screen.card.receive_events() else { break };
            for event in events {
                if let Event::PageFlip(flip) = event
                    && flip.crtc == self.screen.crtc
                {
                    ended = Some(flip.duration);
                }
            }
        }
        match ended {
            Some(_) => self.flips.ended(),
            None => self.flips.late(),
        }
        self.front = waiting;
        self.flipped_at = ended;
    }

    /// Whether the card has an event to read within `timeout`.
    fn readable(&self, timeout: Duration) -> bool {
        let mut fds = [PollFd::new(&self.screen.card, PollFlags::IN)];
        let timeout = Timespec { tv_sec: timeout.as_secs() as _, tv_nsec: timeout.subsec_nanos() as _ };
        loop {
            match poll(&mut fds, Some(&timeout)) {
                Ok(_) => return fds[0].revents().contains(PollFlags::IN),
                Err(rustix::io::Errno::INTR) => continue,
                Err(_) => return false,
            }
        }
    }

    /// See [`super::Sink::scan_out_hash`].
    pub fn scan_out_hash(&mut self) -> u64 {
        self.wait_for_flip();
        let size = self.mode();
        let mut hash = Hash::new(size);
        let shown = &self.buffers[self.front];
        for row in
            shown.map.iter().flat_map(|map| map.chunks(shown.buffer.pitch() as usize)).take(size.height)
        {
            hash.row(&row[..size.width * 4]);
        }
        hash.finish()
    }

    /// See [`super::Sink::check`].
    pub fn check(&self) -> Result<(), DisplayError> {
        let Screen { card, connector, name, .. } = &self.screen;
        // without a probe: the kernel hears of cables by itself
        let state =
            card.get_connector(*connector, false).map_err(|e| refused(card, "look at its screen", e))?;
        match state.state() {
            State::Disconnected => {
                Err(DisplayError::Unplugged { card: card.path.clone(), screen: name.clone() })
            }
            _ => Ok(()),
        }
    }

    /// Size of the mode.
    pub fn mode(&self) -> Size {
        mode_size(&self.screen.mode)
    }

    /// Flips whose event never came within the time-out.
    pub fn lost_flips(&self) -> u64 {
        self.flips.lost()
    }
}

impl ScanOut {
    /// Copies a picture of the buffer's size, row by row.
    fn write(&mut self, image: &Xrgb) {
        let pitch = self.buffer.pitch() as usize;
        if let Some(map) = &mut self.map {
            for (to, from) in map.chunks_mut(pitch).zip(image.rows()) {
                to[..from.len()].copy_from_slice(from);
            }
        }
    }

    /// Gives everything back to the kernel; what it refuses goes with the card's file.
    fn free(&mut self, card: &Card) {
        self.map = None;
        if let Some(framebuffer) = self.framebuffer.take() {
            let _ = card.destroy_framebuffer(framebuffer);
        }
        let _ = card.destroy_dumb_buffer(self.buffer);
    }
}

impl Drop for Kms {
    fn drop(&mut self) {
        self.wait_for_flip();
        let Screen { card, crtc, connector, .. } = &self.screen;
        if let Some(before) = self.before.take()
            && let Err(error) = match (before.mode(), before.framebuffer()) {
                (Some(mode), Some(shown)) => {
                    card.set_crtc(*crtc, Some(shown), before.position(), &[*connector], Some(mode))
                }
                _ => card.set_crtc(*crtc, None, (0, 0), &[], None),
            }
        {
            log::debug!("{}: cannot put the screen back: {error}", card.path.display());
        }
        for buffer in &mut self.buffers {
            buffer.free(card);
        }
    }
}

impl std::fmt::Display for Kms {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Screen { card, name, mode, .. } = &self.screen;
        write!(f, "{} {name} {} at {} Hz", card.path.display(), mode_size(mode), mode.vrefresh())
    }
}

impl std::fmt::Debug for Kms {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Kms({self})")
    }
}

fn busy_error(error: &Error) -> bool {
    error.kind() == ErrorKind::ResourceBusy
}

fn refused(card: &Card, doing: &'static str, source: Error) -> DisplayError {
    let card = card.path.clone();
    match source.kind() {
        ErrorKind::PermissionDenied => DisplayError::Owned { card },
        _ => DisplayError::Refused { card, doing, source },
    }
}
