//! Buttons on a serial line: VBP/1, one checked ASCII line a message, healed by state.
//!
//! Comes in: bytes of a serial port; goes out: presses, and lines that tell the board and whoever listens what the
//! visor does. Pure from the inside out: `codec` (bytes ↔ messages), `press` (edges and states on the board's clock →
//! presses), `link` (handshake, acknowledgements, heartbeat; time is passed in); only `port` has a thread and a
//! device. What a press means to the appliance is decided in `app`. `keys`: keys of the kernel's input layer beside them.

mod codec;
mod config;
mod console;
pub mod keys;
mod link;
mod port;
mod press;
mod status;

pub use codec::{Dropped, Heard, Line, Outcome, Said, Wire, checksum, frame};
pub use config::{Action, ButtonConfig, Config, Console};
pub use link::{Ask, Link};
pub use port::{Port, PortError};
pub use press::{Kind, Press, Presses, Wanted};
pub use status::{Markers, Mode, Status};
