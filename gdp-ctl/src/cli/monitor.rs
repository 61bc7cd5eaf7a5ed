//! `gdp-ctl monitor`: live events at the daemon's switch.

use crate::cli::context::Context;
use gdp_proto::admin::event::{Event, TimedEvent};

pub fn run(context: &Context) -> anyhow::Result<()> {
    for event in context.client()?.monitor()? {
        let event = event?;
        context.output.print(&event, || [describe(&event)])?;
    }
    Ok(())
}

fn describe(TimedEvent { at, event }: &TimedEvent) -> String {
    let (seconds, millis) = (at / 1_000_000_000, at / 1_000_000 % 1000);
    let clock = format!("{:02}:{:02}:{:02}.{millis:03}Z", seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    let (kind, what) = words(event);
    format!("{clock}  {kind:12}  {what}")
}

/// Returns what kind of event it is, and the rest of its description.
pub fn words(event: &Event) -> (&'static str, String) {
    match event {
        Event::LinkUp { peer, role, relationship, via, address } => {
            ("link up", format!("{peer:#} ({role}, {relationship}) {via} {address}"))
        }
        Event::LinkDown { peer, reason } => ("link down", format!("{peer:#}: {reason}")),
        Event::LinkRefused { peer, via, reason } => ("link refused", format!("{peer:#} {via}: {reason}")),
        Event::RegistrationRefused { entity, reason, .. } => ("refused", format!("{entity:#}: {reason}")),
        Event::Suspicious { what, count, peer } => {
            let from = peer.map(|peer| format!(", most over the link of {peer:#}")).unwrap_or_default();
            ("suspicious", format!("{count} × {what}{from}"))
        }
        Event::Attached { entity } => ("attached", format!("{entity:#}")),
        Event::Detached { entity } => ("detached", format!("{entity:#}")),
        Event::Routes { changes, generation } => ("routes", format!("{changes} changed, generation {generation}")),
        Event::Topology { reached, switches } => ("topology", format!("{reached} of {switches} switches reached")),
        Event::Rib { names, switches } => ("rib", format!("{names} names, {switches} switches")),
        Event::Missed { events } => ("missed", format!("{events} events: this program reads too slowly")),
    }
}

#[cfg(test)]
#[path = "../../tests/unit/cli/monitor.rs"]
mod tests;
