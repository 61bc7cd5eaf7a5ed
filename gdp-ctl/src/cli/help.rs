//! The list of commands in `gdp-ctl --help`, in groups.

use clap::Command;

/// Groups of commands, each with its commands in the order of the help.
const GROUPS: [(&str, &[&str]); 3] = [
    (
        "Everyday",
        &[
            "up", "invite", "robots", "approve", "deny", "revoke", "apply", "admin", "status", "top", "web", "doctor",
            "topic", "service", "action",
        ],
    ),
    ("Rights", &["key", "name", "grant", "domain", "cert"]),
    (
        "Inside",
        &[
            "serve",
            "join-service",
            "query",
            "advertise",
            "withdraw",
            "ping",
            "trace",
            "topology",
            "monitor",
            "link",
            "peer",
            "fib",
            "rib",
            "xdp",
            "completion",
        ],
    ),
];

/// Returns the command line with grouped help. A command without a group is listed last.
pub fn grouped(command: Command) -> Command {
    let others = command.get_subcommands().map(Command::get_name).filter(|name| !is_grouped(name));
    let others: Vec<&str> = others.collect();
    let groups = GROUPS.iter().map(|(title, names)| (*title, *names)).chain([("Other", &others[..])]);
    let mut list = String::new();
    for (title, names) in groups.filter(|(_, names)| !names.is_empty()) {
        list += &format!("{title}:\n");
        for name in names {
            let about = command.find_subcommand(name).and_then(Command::get_about);
            list += &format!("  {name:12} {}\n", about.map(ToString::to_string).unwrap_or_default());
        }
        list.push('\n');
    }
    command.help_template(format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}Options:\n{{options}}{{after-help}}"
    ))
}

fn is_grouped(name: &str) -> bool {
    GROUPS.iter().any(|(_, names)| names.contains(&name))
}

#[cfg(test)]
#[path = "../../tests/unit/cli/help.rs"]
mod tests;
