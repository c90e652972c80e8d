//! What the service manager is told: ready once a picture is shown, alive while pictures are shown, stopping; and, in
//! words, whether pictures are shown. A visor that waits for its screen is not ready and not stuck: it asks for more time
//! to start as long as its frame loop runs.
//!
//! A thread of its own writes to the manager's socket; the frame loop only counts. Without a manager
//! (`NOTIFY_SOCKET` is not set) nothing is done.

use sd_notify::NotifyState;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// How often the manager hears of us where it asks for no watchdog.
const REPORT_EVERY: Duration = Duration::from_secs(10);
/// How much more time to start is asked for at every report while a screen is waited for, microseconds.
const MORE_TIME_US: u32 = 30_000_000;
/// What is going on, in words.
const SHOWING: &str = "showing pictures";
const WAITING: &str = "nothing to show on: no screen, or dark by wish";

/// The service manager's side of a run; when dropped, it is told that the run ends.
pub struct Service {
    told: Arc<Told>,
    thread: Option<JoinHandle<()>>,
}

#[derive(Default)]
struct Told {
    shown: AtomicU64,
    waited: AtomicU64,
    stop: AtomicBool,
}

impl Service {
    /// Begins to report, where a manager listens.
    pub fn start() -> std::io::Result<Self> {
        let told = Arc::<Told>::default();
        let listens = std::env::var_os("NOTIFY_SOCKET").is_some_and(|path| !path.is_empty());
        let thread = match listens {
            true => {
                let told = told.clone();
                Some(std::thread::Builder::new().name("service".into()).spawn(move || report(&told))?)
            }
            false => None,
        };
        Ok(Self { told, thread })
    }

    /// One more picture is on the screen.
    pub fn shown(&self) {
        if self.told.shown.fetch_add(1, Ordering::Relaxed) == 0
            && let Some(thread) = &self.thread
        {
            thread.thread().unpark();
        }
    }
}

impl Service {
    /// Nothing could be shown, and that is known: no screen is there, or the screen is dark by wish. The loop is alive.
    pub fn alive(&self) {
        self.told.waited.fetch_add(1, Ordering::Relaxed);
    }
}

impl Drop for Service {
    fn drop(&mut self) {
        self.told.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // it does nothing but send datagrams; a panic there has been reported
            _ = thread.join();
        }
    }
}

fn report(told: &Told) {
    let watchdog = sd_notify::watchdog_enabled();
    let every = watchdog.map_or(REPORT_EVERY, |limit| limit / 4);
    let (mut ready, mut before, mut said) = (false, (0, 0), "");
    while !told.stop.load(Ordering::Relaxed) {
        let (shown, waited) = (told.shown.load(Ordering::Relaxed), told.waited.load(Ordering::Relaxed));
        let runs = (shown, waited) != before;
        if shown > 0 && !ready {
            (ready, said) = (true, SHOWING);
            tell(&[NotifyState::Ready, NotifyState::Status(SHOWING)]);
        } else if runs && !ready {
            tell(&[NotifyState::ExtendTimeoutUsec(MORE_TIME_US)]);
        } else if runs && watchdog.is_some() {
            tell(&[NotifyState::Watchdog]);
        }
        let state = if shown > before.0 { SHOWING } else { WAITING };
        if runs && state != said {
            said = state;
            tell(&[NotifyState::Status(state)]);
        }
        before = (shown, waited);
        std::thread::park_timeout(every);
    }
    tell(&[NotifyState::Stopping]);
}

/// A manager that does not listen for a while is no reason to stop.
fn tell(states: &[NotifyState<'_>]) {
    if let Err(error) = sd_notify::notify(states) {
        log::warn!("service manager: {error}");
    }
}
