//! Programs that end when their guard is dropped. A file collects their output and can be read
//! while they run.

use std::collections::BTreeMap;
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
    /// The program dies with the *thread* that started it. Therefore even a killed test leaves
    /// nothing behind.
    pub fn spawn(label: &str, command: Command, folder: &Path) -> Result<Self> {
        let stderr = create(&folder.join(format!("{label}.err")))?;
        Self::spawn_with_stderr(label, command, folder, stderr.into())
    }

    /// Starts `command` with another destination for stderr. [`Process::stderr`] is then empty,
    /// unless the destination is `folder/LABEL.err`.
    pub fn spawn_with_stderr(label: &str, mut command: Command, folder: &Path, to: Stdio) -> Result<Self> {
        let stdout = folder.join(format!("{label}.out"));
        let stderr = folder.join(format!("{label}.err"));
        command.stdin(Stdio::null()).stdout(create(&stdout)?).stderr(to);
        // Ctrl-C in the terminal reaches the test alone, which ends its programs in order.
        command.process_group(0);
        // SAFETY: prctl is async-signal-safe and touches none of this process's memory.
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

    /// Returns the processor time of the program's threads so far, without threads that have ended.
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

    /// Returns the voluntary context switches of the program's threads so far, by the name of the
    /// thread.
    pub fn wakeups(&self) -> Result<BTreeMap<String, u64>> {
        let threads = std::fs::read_dir(format!("/proc/{}/task", self.pid())).context("its threads")?;
        let mut wakeups = BTreeMap::new();
        for thread in threads.flatten() {
            // The thread may have ended meanwhile.
            let Ok(text) = std::fs::read_to_string(thread.path().join("status")) else { continue };
            let field = |name: &str| text.lines().find_map(|line| Some(line.strip_prefix(name)?.trim()));
            let Some(count) = field("voluntary_ctxt_switches:").and_then(|count| count.parse::<u64>().ok()) else {
                continue;
            };
            *wakeups.entry(field("Name:").unwrap_or("?").to_owned()).or_default() += count;
        }
        Ok(wakeups)
    }

    /// Returns what the program has written to stdout so far.
    pub fn stdout(&self) -> String {
        read(&self.stdout)
    }

    /// Returns what the program has written to stderr so far.
    pub fn stderr(&self) -> String {
        read(&self.stderr)
    }

    /// Returns the complete lines of stdout so far that are JSON objects.
    pub fn json_lines(&self) -> Vec<Value> {
        let text = self.stdout();
        let complete = text.rfind('\n').map_or("", |end| &text[..end]);
        complete.lines().filter_map(|line| serde_json::from_str(line).ok()).collect()
    }

    /// Returns the program's exit status, if it has ended.
    pub fn status(&mut self) -> Result<Option<ExitStatus>> {
        Ok(self.child.try_wait()?)
    }

    /// Fails with the end of the program's output if it has ended.
    pub fn check_alive(&mut self) -> Result<()> {
        match self.child.try_wait()? {
            None => Ok(()),
            Some(status) => bail!("{} ended early ({status})\n{}", self.label, self.report()),
        }
    }

    /// Waits until `condition` holds for this program. If the program ends first, or at the
    /// deadline, the error shows its output.
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

    /// Sends SIGTERM, waits, and sends SIGKILL after `limit`.
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

    /// Kills the program without a chance to clean up, as a crash does.
    pub fn kill(&mut self) -> Result<ExitStatus> {
        // Killing a child that has already ended is not an error here.
        let _ = self.child.kill();
        Ok(self.child.wait()?)
    }

    /// Returns the end of the program's output, for a failure message.
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
            // The child may have ended meanwhile.
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
    // SAFETY: the child is not reaped yet, so the kernel cannot have reused its pid.
    match unsafe { libc::kill(child.id() as libc::pid_t, signal) } {
        0 => Ok(()),
        _ => Err(std::io::Error::last_os_error()),
    }
}

fn read(path: &Path) -> String {
    String::from_utf8_lossy(&std::fs::read(path).unwrap_or_default()).into_owned()
}
