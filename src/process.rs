//! What a process is told by its surroundings other than by arguments: signals at limits, a standard output that is closed.

use std::io::{Error, ErrorKind, Result, Write};

/// A file that would become larger than the limit of the process makes an error of the write, as a full disk does, and not the end of the
/// process.
#[cfg(unix)]
pub fn outlive_limits() {
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;
    // Without the handler the limit ends the process, which leaves nothing half written, but says nothing either.
    let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, Arc::new(AtomicBool::new(false)));
}

#[cfg(not(unix))]
pub fn outlive_limits() {}

/// Standard output that was closed when the process began: everything written there would be lost.
pub struct Closed;

impl Write for Closed {
    fn write(&mut self, _bytes: &[u8]) -> Result<usize> {
        Err(Error::new(ErrorKind::NotConnected, "it is closed"))
    }

    fn flush(&mut self) -> Result<()> {
        Err(Error::new(ErrorKind::NotConnected, "it is closed"))
    }
}

/// Whether standard output was closed. The runtime puts the null device in its place, open for reading and writing; who sends output there
/// by hand opens it for writing alone.
#[cfg(target_os = "linux")]
pub fn output_is_closed() -> bool {
    /// Bits of the access in the flags of an open file, and their value for reading and writing.
    const ACCESS: (u32, u32) = (3, 2);
    let is_null = std::fs::read_link("/proc/self/fd/1").is_ok_and(|to| to.as_os_str() == "/dev/null");
    let flags = || {
        let text = std::fs::read_to_string("/proc/self/fdinfo/1").ok()?;
        let flags = text.lines().find_map(|line| line.strip_prefix("flags:"))?;
        u32::from_str_radix(flags.trim(), 8).ok()
    };
    is_null && flags().is_some_and(|flags| flags & ACCESS.0 == ACCESS.1)
}

#[cfg(not(target_os = "linux"))]
pub fn output_is_closed() -> bool {
    false
}
