//! A pseudo-terminal with one command. Programs see a person there: they ask, and what is typed
//! appears.

use std::fs::File;
use std::io::{Read as _, Write as _};
use std::os::fd::{FromRawFd as _, OwnedFd};
use std::os::unix::process::CommandExt as _;
use std::process::{Child, Command};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use anyhow::{Context as _, Result, ensure};

pub struct Terminal {
    child: Child,
    keyboard: File,
    screen: Arc<Mutex<String>>,
    /// Ends when the last program has closed the terminal.
    reader: JoinHandle<()>,
    /// The length of the text on the screen when something was typed last.
    typed_at: usize,
}

impl Terminal {
    pub fn open(mut command: Command) -> Result<Self> {
        let (mut master, mut slave) = (-1, -1);
        let nothing = std::ptr::null_mut();
        // SAFETY: both descriptors are written, and the optional arguments may be null.
        let opened = unsafe { libc::openpty(&mut master, &mut slave, nothing, nothing.cast(), nothing.cast()) };
        ensure!(opened == 0, "cannot open a terminal: {}", std::io::Error::last_os_error());
        // SAFETY: nobody else owns the two descriptors.
        let (keyboard, slave) = unsafe { (File::from_raw_fd(master), OwnedFd::from_raw_fd(slave)) };
        command.stdin(slave.try_clone()?).stdout(slave.try_clone()?).stderr(slave).process_group(0);
        // SAFETY: prctl is async-signal-safe and touches none of this process's memory.
        unsafe {
            command.pre_exec(|| match libc::prctl(libc::PR_SET_PDEATHSIG, libc::SIGKILL) {
                0 => Ok(()),
                _ => Err(std::io::Error::last_os_error()),
            });
        }
        let child = command.spawn().context("cannot start a shell")?;
        // The command holds the other end until it is dropped.
        drop(command);
        let screen = Arc::new(Mutex::new(String::new()));
        let (shown, mut from) = (screen.clone(), keyboard.try_clone()?);
        let reader = std::thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(length @ 1..) = from.read(&mut buffer) {
                let text = String::from_utf8_lossy(&buffer[..length]).replace('\r', "");
                shown.lock().unwrap_or_else(PoisonError::into_inner).push_str(&text);
            }
        });
        Ok(Self { child, keyboard, screen, reader, typed_at: 0 })
    }

    /// Returns the text on the screen, without colours and lines of the log, which pages omit.
    pub fn text(&self) -> String {
        let text = without_colours(&self.screen.lock().unwrap_or_else(PoisonError::into_inner));
        text.split_inclusive('\n').filter(|line| !is_log(line)).collect()
    }

    /// Returns whether a program has asked with these words, and nothing was typed since.
    pub fn asks(&self, words: &str) -> bool {
        let text = self.text();
        text.len() > self.typed_at && text.ends_with(words)
    }

    pub fn type_line(&mut self, line: &str) -> Result<()> {
        self.typed_at = self.text().len();
        writeln!(self.keyboard, "{line}").context("cannot type")
    }

    pub fn has_ended(&mut self) -> Result<bool> {
        if self.child.try_wait()?.is_none() {
            return Ok(false);
        }
        // What it printed last may still be on its way.
        let deadline = Instant::now() + Duration::from_secs(5);
        while !self.reader.is_finished() && Instant::now() < deadline {
            std::thread::sleep(Duration::from_millis(1));
        }
        Ok(true)
    }

    /// Waits for the end of the command. Returns false if it goes on.
    pub fn ends_within(&mut self, limit: Duration) -> Result<bool> {
        let deadline = Instant::now() + limit;
        while Instant::now() < deadline {
            if self.has_ended()? {
                return Ok(true);
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        Ok(false)
    }

    /// Types ^C, and waits for the end.
    pub fn interrupt(mut self) -> Result<()> {
        self.signal(libc::SIGINT);
        ensure!(self.ends_within(Duration::from_secs(10))?, "^C does not end it");
        Ok(())
    }

    fn signal(&self, signal: libc::c_int) {
        // SAFETY: the child is not reaped yet, so the kernel cannot have reused its group.
        unsafe { libc::kill(-(self.child.id() as libc::pid_t), signal) };
    }
}

/// Removes the escape sequences that choose colours.
fn without_colours(text: &str) -> String {
    let mut parts = text.split("\x1b[");
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |text, part| text + part.split_once('m').map_or(part, |(_, after)| after))
}

/// Returns whether a line is `TIME LEVEL …`.
fn is_log(line: &str) -> bool {
    let mut words = line.split_whitespace();
    let is_time = words.next().is_some_and(|word| word.starts_with("20") && word.ends_with('Z'));
    is_time && words.next().is_some_and(|word| ["DEBUG", "INFO", "WARN", "ERROR"].contains(&word))
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if matches!(self.child.try_wait(), Ok(None)) {
            self.signal(libc::SIGTERM);
            if !matches!(self.ends_within(Duration::from_secs(10)), Ok(true)) {
                self.signal(libc::SIGKILL);
                _ = self.child.wait();
            }
        }
        if std::thread::panicking() {
            eprintln!("--- terminal\n{}", self.text());
        }
    }
}
