//! Pages that are written from the code. `cargo xtask reference` writes them all.

const WIDTH: usize = 100;

/// The first line of every such page.
pub const GENERATED: &str = "<!-- `cargo xtask reference` writes this page from the code. -->\n\n";

/// Compares a file with the text that the code makes. With `GDP_BLESS` in the environment, writes
/// the file instead. `path` is relative to the root of the source tree.
///
/// # Panics
///
/// If they differ, or if the file cannot be read or written.
#[track_caller]
pub fn check(path: &str, text: &str) {
    let file = super::root().join(path);
    if std::env::var_os("GDP_BLESS").is_some() {
        let folder = file.parent().expect("a folder");
        std::fs::create_dir_all(folder).and_then(|()| std::fs::write(&file, text)).expect(path);
    } else {
        let committed = std::fs::read_to_string(&file).unwrap_or_default();
        let differs = committed.lines().zip(text.lines()).find(|(committed, made)| committed != made);
        assert!(committed == text, "{path} is not what the code says: run `cargo xtask reference`; {differs:?}");
    }
}

/// Breaks each paragraph of a text into lines.
pub fn wrapped(text: &str) -> String {
    let mut wrapped = String::new();
    for paragraph in text.split("\n\n").filter(|paragraph| !paragraph.trim().is_empty()) {
        let mut width = 0;
        for word in paragraph.split_whitespace() {
            let length = word.chars().count();
            let separator = match width {
                0 => "",
                _ if width + 1 + length > WIDTH => "\n",
                _ => " ",
            };
            width = if separator == " " { width + 1 + length } else { length };
            wrapped.push_str(separator);
            wrapped.push_str(word);
        }
        wrapped.push_str("\n\n");
    }
    wrapped
}

/// Returns a table. Without rows, returns nothing.
pub fn table(columns: &[&str], rows: &[Vec<String>]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
    let head = line(columns.iter().map(|column| (*column).to_owned()).collect());
    let rule = line(columns.iter().map(|_| "---".to_owned()).collect());
    let rows: String = rows.iter().map(|row| line(row.iter().map(|text| cell(text)).collect())).collect();
    format!("{head}{rule}{rows}\n")
}

/// Returns a text on one line, without links that only Rust's documentation has.
pub fn cell(text: &str) -> String {
    let line = text.split_whitespace().collect::<Vec<_>>().join(" ");
    line.replace("[`", "`").replace("`]", "`").replace('|', "\\|")
}

/// Returns a text without the last line break of a page that ends with a blank line.
pub fn page(title: &str, body: &str) -> String {
    format!("{GENERATED}# {title}\n\n{}\n", body.trim_end())
}
