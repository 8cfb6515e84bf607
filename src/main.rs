//! The `calfit` program.

mod process;

use calfit::cli::{Output, run};
use std::io::{IsTerminal, Write, stderr, stdout};
use std::process::ExitCode;

fn main() -> ExitCode {
    process::outlive_limits();
    let (mut out, mut err) = (stdout(), stderr());
    let is_terminal = out.is_terminal();
    let mut closed = process::Closed;
    let to: &mut (dyn Write + Send) = if process::output_is_closed() { &mut closed } else { &mut out };
    let err = Output { is_terminal: err.is_terminal(), to: &mut err };
    run(std::env::args_os(), Output { is_terminal, to }, err).into()
}
