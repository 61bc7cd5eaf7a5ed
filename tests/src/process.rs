//! Programs that end when their guard is dropped. Their output is kept in a file and can be read
//! while they run.

use std::fs::File;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use serde_json::Value;

use crate::wait::wait_for;

/// A running program: its own process group, stdout in one file and stderr in another.
pub struct Process {
    label: String,
    child: Child,
    stdout: PathBuf,
    stderr: PathBuf,
}

impl Process {
    /// Starts `command` and writes its output to `folder/LABEL.out` and `folder/LABEL.err`.
    ///
    /// The program dies with the *thread* that started it, so that even a killed test leaves
    /// nothing behind.
    pub fn spawn(label: &str, command: Command, folder: &Path) -> Result<Self> {
        let stderr = create(&folder.join(format!("{label}.err")))?;
        Self::spawn_with_stderr(label, command, folder, stderr.into())
    }

    /// The same, with stderr elsewhere; then [`Process::stderr`] is empty, unless that is
    /// `folder/LABEL.err`.
    pub fn spawn_with_stderr(label: &str, mut command: Command, folder: &Path, to: Stdio) -> Result<Self> {
        let stdout = folder.join(format!("{label}.out"));
        let stderr = folder.join(format!("{label}.err"));
        command.stdin(Stdio::null()).stdout(create(&stdout)?).stderr(to);
        // Ctrl-C in the terminal is for us alone: we end our programs in order.
        command.process_group(0);
        // SAFETY: prctl is async-signal-safe and touches no memory of ours.
        unsafe {
            command.pre_exec(|| match libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) {
                0 => Ok(()),
                _ => Err(std::io::Error::last_os_error()),
            });
        }
        let child = command.spawn().with_context(|| format!("cannot start {:?}", command.get_program()))?;
        Ok(Self { label: label.to_owned(), child, stdout, stderr })
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Processor time that its threads have taken so far, those that have ended left out.
    pub fn cpu(&self) -> Result<Duration> {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.pid())).context("its threads")?;
        let taken = threads.flatten().filter_map(|thread| {
            // The first number is nanoseconds on a processor
            // (Documentation/scheduler/sched-stats.rst).
            let text = std::fs::read_to_string(thread.path().join("schedstat")).ok()?;
            text.split_ascii_whitespace().next()?.parse::<u64>().ok()
        });
        Ok(Duration::from_nanos(taken.sum()))
    }

    /// What it has written to stdout so far.
    pub fn stdout(&self) -> String {
        read(&self.stdout)
    }

    /// What it has written to stderr so far.
    pub fn stderr(&self) -> String {
        read(&self.stderr)
    }

    /// The complete lines of stdout so far that are JSON objects.
    pub fn json_lines(&self) -> Vec<Value> {
        let text = self.stdout();
        let complete = text.rfind('\n').map_or("", |end| &text[..end]);
        complete.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    /// How it ended, if it has.
    pub fn status(&mut self) -> Result<Option<ExitStatus>> {
        Ok(self.child.try_wait()?)
    }

    /// An error with the end of its output if it has ended.
    pub fn check_alive(&mut self) -> Result<()> {
        match self.child.try_wait()? {
            None => Ok(()),
            Some(status) => bail!("{} ended early ({status})\n{}", self.label, self.report()),
        }
    }

    /// Waits until `condition` holds for this program; if it ends meanwhile, or at the deadline,
    /// shows its output.
    pub fn wait_until<T>(
        &mut self,
        what: &str,
        limit: Duration,
        mut condition: impl FnMut(&Self) -> Option<T>,
    ) -> Result<T> {
        let label = self.label.clone();
        let waited = wait_for(&format!("{label}: {what}"), limit, || {
            let value = condition(self);
            if value.is_none() {
                self.check_alive()?;
            }
            Ok(value)
        });
        waited.with_context(|| self.report())
    }

    /// Waits for a JSON line with `"event": EVENT`.
    pub fn wait_event(&mut self, event: &str, limit: Duration) -> Result<Value> {
        self.wait_until(&format!("event {event}"), limit, |p| p.json_lines().into_iter().find(|v| v["event"] == event))
    }

    /// Asks it to end (SIGTERM), waits, and insists (SIGKILL) after `limit`.
    pub fn stop(&mut self, limit: Duration) -> Result<ExitStatus> {
        self.signal(libc::SIGTERM);
        let deadline = Instant::now() + limit;
        while Instant::now() < deadline {
            if let Some(status) = self.child.try_wait()? {
                return Ok(status);
            }
            std::thread::sleep(Duration::from_millis(5));
        }
        self.kill()
    }

    /// Ends it without a chance to say goodbye, as a crash does.
    pub fn kill(&mut self) -> Result<ExitStatus> {
        // Kill of a child that has ended already is not an error to us.
        let _ = self.child.kill();
        Ok(self.child.wait()?)
    }

    /// The end of its output, for a failure message.
    pub fn report(&self) -> String {
        let tail = |text: String| -> String {
            let lines: Vec<&str> = text.lines().collect();
            lines[lines.len().saturating_sub(30)..].join("\n")
        };
        format!(
            "--- {} stdout\n{}\n--- {} stderr\n{}",
            self.label,
            tail(self.stdout()),
            self.label,
            tail(self.stderr())
        )
    }

    fn signal(&mut self, signal: libc::c_int) {
        if matches!(self.child.try_wait(), Ok(None)) {
            // It may have ended meanwhile.
            let _ = send(&self.child, signal);
        }
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        let _ = self.kill();
        if std::thread::panicking() {
            eprintln!("{}", self.report());
        }
    }
}

fn create(path: &Path) -> Result<File> {
    File::create(path).with_context(|| format!("cannot create {}", path.display()))
}

/// Sends SIGTERM to a child that has not been waited for.
pub fn terminate(child: &Child) -> Result<()> {
    send(child, libc::SIGTERM).context("cannot send SIGTERM")
}

fn send(child: &Child, signal: libc::c_int) -> std::io::Result<()> {
    // SAFETY: the child is ours and not reaped yet, so the pid cannot have been given to another
    // process.
    match unsafe { libc::kill(child.id() as libc::pid_t, signal) } {
        0 => Ok(()),
        _ => Err(std::io::Error::last_os_error()),
    }
}

fn read(path: &Path) -> String {
    String::from_utf8_lossy(&std::fs::read(path).unwrap_or_default()).into_owned()
}
