//! `cargo xtask VERB`: all developer tasks of this project, one file for each verb.
//!
//! Each verb is a module with `Options` and `run`. Verbs share [`shell`] (running commands) and
//! [`workspace`] (paths). Nothing here is part of the product.

mod bench;
mod book;
mod build;
mod check;
mod debug_symbols;
mod demo;
mod deny;
mod eval;
mod field_report;
mod fresh;
mod fuzz;
mod git;
mod models;
mod package;
mod pairings;
mod peers;
mod portable;
mod reference;
mod remap;
mod run;
mod setup;
mod shell;
mod soak;
mod test;
mod workspace;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};
use gdp_tests::wait::Interrupted;

#[derive(Parser)]
#[command(name = "cargo xtask", about = "Build, set up, run, test, show and measure")]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    /// Install the missing tools and libraries, after printing each with its reason
    Setup(setup::Options),
    /// Build the eBPF programs and the executables
    Build(build::Options),
    /// Build, then start `gdp-ctl serve`
    Run(run::Options),
    /// Run unit tests, kernel tests and network-namespace tests (needs root)
    Test(test::Options),
    /// Send a ROS 2 topic across a network of switches from one DDS vendor to another (needs root)
    Demo(demo::Options),
    /// Check the rules of the source tree: import cycles, lengths, words, facade, links
    Check(check::Options),
    /// Check licences, banned crates and sources of all dependencies
    Deny(deny::Options),
    /// Build the documents as a book, in the folder `book`
    Book(book::Options),
    /// Write the pages and schemas of docs that are made from the code
    Reference(reference::Options),
    /// Try each ROS software with rclpy through two proxies, and print the table of docs/ros.md
    Pairings(pairings::Options),
    /// Make Debian packages, a tar and an image, and check them
    Package(package::Options),
    /// Fuzz the parsers of untrusted input
    Fuzz(fuzz::Options),
    /// Check the models of the protocols with Verifpal, and that it finds the attacks it must find
    Models(models::Options),
    /// Run proxies and a switch under churn and kills, and check what they use (needs root)
    Soak(soak::Options),
    /// Set up, build, start and test the project on a clean Debian 12 (needs root)
    Fresh(fresh::Options),
    /// Run a benchmark, and print a table or JSON (needs root)
    Bench(bench::Options),
    /// Make a figure of the paper's evaluation again, and print a table or JSON (needs root)
    Eval(eval::Options),
    /// Measure between two own machines, and print a table to send in (needs root on one of them)
    FieldReport(field_report::Options),
}

fn main() -> ExitCode {
    let result = match Cli::parse().verb {
        Verb::Setup(options) => setup::run(options),
        Verb::Build(options) => build::run(options),
        Verb::Run(options) => run::run(options),
        Verb::Test(options) => test::run(options),
        Verb::Demo(options) => demo::run(options),
        Verb::Check(options) => check::run(options, &Cli::command()),
        Verb::Deny(options) => deny::run(options),
        Verb::Book(options) => book::run(options),
        Verb::Reference(options) => reference::run(options),
        Verb::Pairings(options) => pairings::run(options),
        Verb::Package(options) => package::run(options),
        Verb::Fuzz(options) => fuzz::run(options),
        Verb::Models(options) => models::run(options),
        Verb::Soak(options) => soak::run(options),
        Verb::Fresh(options) => fresh::run(options),
        Verb::Bench(options) => bench::run(options),
        Verb::Eval(options) => eval::run(options),
        Verb::FieldReport(options) => field_report::run(options),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) if error.is::<Interrupted>() => {
            eprintln!("interrupted; everything is cleaned up");
            ExitCode::from(130)
        }
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
