//! The binary: see [`gdp_ctl::cli`].

fn main() -> std::process::ExitCode {
    gdp_ctl::cli::main()
}
