//! Puts the commit into `--version`; a source tree without git says so.

use std::process::Command;

fn main() {
    let git = |args: &[&str]| {
        let output = Command::new("git").args(args).output().ok().filter(|o| o.status.success())?;
        String::from_utf8(output.stdout).ok().map(|text| text.trim().to_string())
    };
    let commit = git(&["rev-parse", "--short=12", "HEAD"]).unwrap_or_else(|| "no commit".into());
    println!("cargo:rustc-env=VERNISSAGE_COMMIT={commit}");
    println!("cargo:rerun-if-changed=build.rs");
    // a new commit moves HEAD's log; without it the build would keep the old name
    if let Some(log) = git(&["rev-parse", "--git-path", "logs/HEAD"]) {
        println!("cargo:rerun-if-changed={log}");
    }
}
