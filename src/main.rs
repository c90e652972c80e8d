//! The `vernissage` command: everything is in the library's `app`.

use std::process::ExitCode;

fn main() -> ExitCode {
    vernissage::app::main()
}
