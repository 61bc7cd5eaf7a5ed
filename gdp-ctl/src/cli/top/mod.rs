//! `gdp-ctl top`: a screen with robots, topics, names, links and drops, once a second.

mod model;
mod sample;
mod screen;
mod sort_key;

use std::io::IsTerminal;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering::Relaxed};
use std::sync::{Arc, mpsc};
use std::time::{Duration, Instant};

use anyhow::{Context as _, bail};
use clap::Args;
use gdp_util::terminal;
use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEventKind, KeyModifiers};
use tokio::signal::unix::{SignalKind, signal};

use self::model::Model;
use self::sample::{Sources, TopSample};
use self::sort_key::SortKey;
use super::home::HomeOptions;
use crate::cli::context::Context;

/// Time between two screens.
const PERIOD: Duration = Duration::from_secs(1);

/// Time within which a signal ends the command.
const LOOK: Duration = Duration::from_millis(200);

/// Watch robots, topics, links and drops of this machine, as they change.
///
/// The figures are those of this machine's switch and proxy: `gdp-ctl status` and
/// `gdp-ctl status --proxy`. Rates are of the last second. Robots are shown where the files of the
/// domain are. Keys: m, b, l, a, n sort topics by messages, bytes, lost, age and name; q ends.
#[derive(Debug, Args)]
pub struct Options {
    /// Print one screen as text, then exit.
    #[arg(long)]
    once: bool,
    /// Columns of the screen with --once.
    #[arg(long, value_name = "COLUMNS", default_value_t = 120, value_parser = clap::value_parser!(u16).range(60..=400))]
    width: u16,
    /// Order of the topics.
    #[arg(long, value_enum, default_value_t = SortKey::Messages)]
    sort: SortKey,
    /// Path of the proxy's admin socket.
    #[arg(long, env = "GDP_PROXY_SOCKET", value_name = "PATH")]
    proxy_socket: Option<PathBuf>,
    #[command(flatten)]
    home: HomeOptions,
}

pub fn run(options: &Options, context: &Context) -> anyhow::Result<()> {
    if context.output.json {
        bail!("`top` prints no JSON; use `gdp-ctl status -j` and `gdp-ctl status --proxy -j`");
    }
    let mut sources = Sources::new(context, options.proxy_socket.clone(), &options.home);
    let first = sources.sample()?;
    if options.once {
        std::thread::sleep(PERIOD);
        let model = Model::new(Some(&first), &sources.sample()?, options.sort);
        return terminal::print(screen::text(&model, options.width)).context("cannot write to stdout");
    }
    if !std::io::stdout().is_terminal() || !std::io::stdin().is_terminal() {
        bail!("`top` needs a terminal; use `gdp-ctl top --once`, or `gdp-ctl status`");
    }
    let stopped = stop_signal()?;
    // This also restores the terminal at a panic, before it is reported.
    let mut terminal = ratatui::try_init().context("cannot use the terminal")?;
    let ended = show(&mut terminal, &mut sources, first, options.sort, &stopped);
    ratatui::restore();
    ended
}

/// Shows screens until the user or a signal ends it.
fn show(
    terminal: &mut DefaultTerminal,
    sources: &mut Sources,
    first: TopSample,
    mut sort: SortKey,
    stopped: &AtomicBool,
) -> anyhow::Result<()> {
    let (mut before, mut now) = (None, first);
    let mut due = Instant::now() + PERIOD;
    while !stopped.load(Relaxed) {
        terminal.draw(|frame| screen::draw(frame, &Model::new(before.as_ref(), &now, sort)))?;
        // Until the next sample is due, keys and a new size change the screen at once.
        while !stopped.load(Relaxed) {
            let rest = due.saturating_duration_since(Instant::now());
            if rest.is_zero() {
                // A program that is restarted comes back.
                let next = sources.sample().unwrap_or_else(|error| TopSample::failed(&error));
                (before, now, due) = (Some(now), next, Instant::now() + PERIOD);
                break;
            }
            if !event::poll(rest.min(LOOK))? {
                continue;
            }
            match event::read()? {
                Event::Key(key) if key.kind == KeyEventKind::Release => {}
                Event::Key(key) => match key.code {
                    KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => return Ok(()),
                    KeyCode::Char('q') | KeyCode::Esc => return Ok(()),
                    KeyCode::Char(pressed) => {
                        sort = SortKey::of(pressed).unwrap_or(sort);
                        break;
                    }
                    _ => {}
                },
                Event::Resize(..) => break,
                _ => {}
            }
        }
    }
    Ok(())
}

/// Returns a flag that SIGINT, SIGTERM and SIGHUP set. They no longer kill the process, which
/// restores the terminal first.
fn stop_signal() -> anyhow::Result<Arc<AtomicBool>> {
    let flag = Arc::new(AtomicBool::new(false));
    let (ours, (ready, listens)) = (flag.clone(), mpsc::channel());
    let runtime =
        tokio::runtime::Builder::new_current_thread().enable_all().build().context("cannot start a runtime")?;
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async {
            let kinds = [SignalKind::interrupt(), SignalKind::terminate(), SignalKind::hangup()];
            let signals = kinds.into_iter().filter_map(|kind| signal(kind).ok()).collect::<Vec<_>>();
            _ = ready.send(());
            let waiting = signals.into_iter().map(|mut signal| Box::pin(async move { signal.recv().await }));
            futures::future::select_all(waiting).await;
            ours.store(true, Relaxed);
        });
    })?;
    listens.recv().context("cannot wait for signals")?;
    Ok(flag)
}
