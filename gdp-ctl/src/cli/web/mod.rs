//! `gdp-ctl web`: a read-only page about this machine's switch, its domain and its robots.
//!
//! - [`collect`]: asks the daemon, and reads the domain's files
//! - [`snapshot`]: what the page shows; [`view`] makes it from replies, [`problems`] what is wrong
//! - [`events`]: the latest events; [`path`]: who uses a name, and where it leads
//! - `page/`: HTML, style and script, which are part of this program
//!
//! The script builds the page from text nodes alone, so a text of others never becomes markup. The
//! policy of the page forbids everything that does not come from this server.

mod collect;
mod events;
mod path;
mod problems;
mod snapshot;
mod view;

use std::io::IsTerminal as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;

use anyhow::Context as _;
use clap::Args;
use gdp_core::name::NamePrefix;
use gdp_http::{Access, AccessToken, HttpRequest, HttpResponse, Listener, StatusCode, parse_address, serve};
use gdp_util::folders;
use gdp_util::signals;
use gdp_util::terminal::note;
use schemars::JsonSchema;
use serde::Serialize;
use tokio::sync::Semaphore;

use super::home::HomeOptions;
use crate::cli::context::Context;
use collect::Collector;
use events::RecentEvents;
use snapshot::text;

/// Show the switch, its domain and its robots on a web page.
///
/// The page changes nothing. On a terminal, the command prints an address with a token, which lets
/// a browser of this machine in. Elsewhere, where a log may keep the output, it needs --token-file.
/// The page shows the topology, links, names, domains, members and events, and rates as they
/// change. It needs no internet.
///
/// For a look from elsewhere, forward the port: `ssh -L 8315:127.0.0.1:8315 SWITCH`. A listener on
/// another address than loopback needs --token-file, and sends everything in clear.
#[derive(Debug, Args)]
pub struct Options {
    /// Address and port to listen on, or a port of 127.0.0.1.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8315", value_parser = parse_address)]
    listen: SocketAddr,
    /// File with the token, of mode 0600, instead of a new one for each start. A token is 16 to 256
    /// letters, digits, dots, hyphens, tildes and underscores.
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
    /// Folder with name cards, for the ROS names of the names. Default: ~/.config/gdp, or /etc/gdp
    /// for root.
    #[arg(long, env = "GDP_KEYRING", value_name = "FOLDER")]
    keyring: Option<PathBuf>,
    #[command(flatten)]
    home: HomeOptions,
}

/// Output of `gdp-ctl web`.
#[derive(Debug, Serialize, JsonSchema)]
pub struct WebOutput {
    /// The address for a browser, with the token unless that is in a file.
    url: String,
}

/// Begins the name of the cookie that a browser keeps.
const COOKIE: &str = "gdp_web";

/// Only what this server sends, and no markup made by scripts.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src data:; \
                      base-uri 'none'; form-action 'none'; frame-ancestors 'none'; require-trusted-types-for 'script'";

const HTML: &str = include_str!("page/index.html");
const STYLE: &str = include_str!("page/style.css");
const SCRIPTS: [(&str, &str); 3] = [
    ("/map.js", include_str!("page/map.js")),
    ("/tables.js", include_str!("page/tables.js")),
    ("/page.js", include_str!("page/page.js")),
];

pub fn run(options: Options, context: &Context) -> anyhow::Result<()> {
    let token = match &options.token_file {
        Some(file) => AccessToken::from_file(file)?,
        None if !options.listen.ip().to_canonical().is_loopback() => anyhow::bail!(
            "{} is reached by other machines, so the page needs a token of yours; say where it is with --token-file, \
             or listen on 127.0.0.1",
            options.listen
        ),
        None if !std::io::stdout().is_terminal() => anyhow::bail!(
            "the output is no terminal, and a log may keep the address with its token; write a token with \
             `umask 077 && openssl rand -hex 32 > FILE`, and say where it is with --token-file"
        ),
        None => AccessToken::random().context("no random numbers")?,
    };
    let secret = options.token_file.is_none().then(|| token.secret().to_owned());
    let keyring = options.keyring.or_else(folders::configuration);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build()?;
    runtime.block_on(async {
        let stop = signals::stop().context("cannot wait for SIGTERM and SIGINT")?;
        let listener = Listener::bind(options.listen, Access::token_or_cookie(token, COOKIE))?;
        let address = listener.address();
        let events = RecentEvents::follow(context.clone());
        let collector = Arc::new(Collector::new(context.clone(), options.home, keyring, events));
        // Whoever has the file knows its token.
        let url = format!("http://{address}/?token={}", secret.as_deref().unwrap_or("…"));
        let output = WebOutput { url };
        context.output.print(&output, || [output.url.clone()])?;
        note(match &options.token_file {
            None => "gdp-ctl: open this address in a browser; it holds a secret; ^C ends the page".into(),
            Some(file) => format!(
                "gdp-ctl: open this address in a browser, with the token in {} at its end; ^C ends the page",
                file.display()
            ),
        });
        let one_path = Arc::new(Semaphore::new(1));
        tokio::select! {
            () = serve(listener, move |request| answer(request, collector.clone(), one_path.clone())) => {}
            () = stop => {}
        }
        anyhow::Ok(())
    })?;
    // A thread may still wait for the daemon.
    runtime.shutdown_background();
    Ok(())
}

async fn answer(request: HttpRequest, collector: Arc<Collector>, one_path: Arc<Semaphore>) -> HttpResponse {
    match request.path.as_str() {
        "/" => HttpResponse::ok("text/html; charset=utf-8", HTML).with_policy(POLICY),
        "/style.css" => HttpResponse::ok("text/css; charset=utf-8", STYLE),
        "/api/snapshot" => {
            let snapshot = tokio::task::spawn_blocking(move || collector.snapshot()).await;
            json(snapshot.map_err(Into::into).flatten())
        }
        "/api/path" => path_answer(&request, collector, one_path).await,
        path => match SCRIPTS.iter().find(|(of, _)| *of == path) {
            Some((_, script)) => HttpResponse::ok("text/javascript; charset=utf-8", *script),
            None => HttpResponse::not_found(),
        },
    }
}

/// Answers one question about a path at a time, because each sends probes.
async fn path_answer(request: &HttpRequest, collector: Arc<Collector>, one_path: Arc<Semaphore>) -> HttpResponse {
    let name = request.parameter("name").unwrap_or_default();
    let prefix: NamePrefix = match name.trim().parse() {
        Ok(prefix) => prefix,
        Err(error) => return HttpResponse::text(StatusCode::BAD_REQUEST, &text(&format!("{error}"))),
    };
    let Ok(permit) = one_path.try_acquire_owned() else {
        return HttpResponse::text(StatusCode::TOO_MANY_REQUESTS, "another path is being traced; try again soon");
    };
    let found = tokio::task::spawn_blocking(move || {
        let found = path::find(&prefix, &collector);
        drop(permit);
        found
    });
    json(async { Ok(serde_json::to_string(&found.await??)?) }.await)
}

fn json(body: anyhow::Result<String>) -> HttpResponse {
    match body {
        Ok(body) => HttpResponse::ok("application/json", body),
        Err(error) => HttpResponse::text(StatusCode::SERVICE_UNAVAILABLE, &text(&format!("{error:#}"))),
    }
}
