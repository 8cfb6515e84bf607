//! The `calfit` program.

fn main() -> std::process::ExitCode {
    calfit::cli::main()
}
