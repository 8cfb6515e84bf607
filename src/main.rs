//! The `calfit` program.

use calfit::cli::{Output, run};
use std::io::{IsTerminal, stderr, stdout};
use std::process::ExitCode;

fn main() -> ExitCode {
    let (mut out, mut err) = (stdout(), stderr());
    let out = Output { is_terminal: out.is_terminal(), to: &mut out };
    let err = Output { is_terminal: err.is_terminal(), to: &mut err };
    run(std::env::args_os(), out, err).into()
}
