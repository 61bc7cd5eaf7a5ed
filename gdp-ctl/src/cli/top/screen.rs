//! Draws the screen of `top`, in a terminal or as text.

use ratatui::backend::TestBackend;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Modifier, Style, Stylize};
use ratatui::text::{Line, Text};
use ratatui::widgets::{Cell, Paragraph, Row, Table};
use ratatui::{Frame, Terminal};

use super::model::{Grid, Model, Tone};
use super::sort_key::SortKey;

/// The maximum width of a column, except the last one.
const MAX_COLUMN: u16 = 40;

/// The maximum number of lines as text.
const MAX_LINES: usize = 1000;

/// The minimum lines that a table gets, as far as the screen has them: heading, two rows and space.
const LEAST: u16 = 4;

pub fn draw(frame: &mut Frame, model: &Model) {
    let notes = model.notes.len() as u16;
    let [title, notes, body, keys] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Length(notes.min(frame.area().height / 3)),
        Constraint::Fill(1),
        Constraint::Length(1),
    ])
    .areas(frame.area());
    frame.render_widget(Paragraph::new(model.title.as_str()).bold(), title);
    let lines = model.notes.iter().map(|(tone, note)| Line::styled(note.as_str(), style(*tone)));
    frame.render_widget(Paragraph::new(lines.collect::<Text>()), notes);
    draw_grids(frame, body, model);
    frame.render_widget(Paragraph::new(help(model.sort)).dim(), keys);
}

fn draw_grids(frame: &mut Frame, body: Rect, model: &Model) {
    // The tables need a heading and a line of space each, beside their rows.
    let wanted = model.grids.iter().map(|grid| grid.rows.len() as u16 + 2);
    let fits = wanted.clone().map(u32::from).sum::<u32>() <= u32::from(body.height);
    let heights = wanted.map(|height| match fits {
        true => Constraint::Length(height),
        false if height <= LEAST => Constraint::Length(height),
        false => Constraint::Fill(height.min(30)),
    });
    let areas = Layout::vertical(heights).split(body);
    for (grid, area) in model.grids.iter().zip(areas.iter()) {
        draw_grid(frame, *area, grid);
    }
}

fn draw_grid(frame: &mut Frame, area: Rect, grid: &Grid) {
    // The heading, and a line of space before the next table.
    let room = usize::from(area.height.saturating_sub(2));
    let (shown, more) = match grid.rows.len() {
        all if all <= room => (all, 0),
        all => (room.saturating_sub(1), all - room.saturating_sub(1)),
    };
    let last = grid.heading.len() - 1;
    let width = |column: usize| {
        let cells = grid.rows.iter().map(|(_, cells)| cells[column].chars().count());
        cells.chain([grid.heading[column].chars().count()]).max().unwrap_or(0) as u16
    };
    let widths = (0..=last).map(|column| match column == last {
        true => Constraint::Fill(1),
        false => Constraint::Length(width(column).min(MAX_COLUMN)),
    });
    let rows = grid
        .rows
        .iter()
        .take(shown)
        .map(|(tone, cells)| Row::new(cells.iter().map(|cell| Cell::new(cell.as_str()))).style(style(*tone)));
    let others = (more > 0).then(|| Row::new([format!("and {more} more")]).style(style(Tone::Dim)));
    let table = Table::new(rows.chain(others), widths)
        .header(Row::new(grid.heading.iter().copied()).style(Style::new().add_modifier(Modifier::REVERSED)))
        .column_spacing(2);
    frame.render_widget(table, area);
}

fn style(tone: Tone) -> Style {
    match tone {
        Tone::Plain => Style::new(),
        Tone::Dim => Style::new().dim(),
        Tone::Alert => Style::new().red().bold(),
    }
}

fn help(sort: SortKey) -> String {
    let by = match sort {
        SortKey::Messages => "messages",
        SortKey::Bytes => "bytes",
        SortKey::Lost => "lost",
        SortKey::Age => "age",
        SortKey::Name => "name",
    };
    format!("topics by {by} · m messages  b bytes  l lost  a age  n name · q ends")
}

/// Returns the screen as lines of text, as high as it needs to be, without the line of keys.
pub fn text(model: &Model, width: u16) -> Vec<String> {
    let rows: usize = model.grids.iter().map(|grid| grid.rows.len() + 2).sum();
    // Notes take at most a third of a screen.
    let height = (rows + 2 + model.notes.len()).max(3 * model.notes.len()).min(MAX_LINES) as u16;
    let mut lines = render(model, width, height);
    lines.pop();
    while lines.last().is_some_and(String::is_empty) {
        lines.pop();
    }
    lines
}

/// Returns the lines of a screen of this size.
pub fn render(model: &Model, width: u16, height: u16) -> Vec<String> {
    let Ok(mut terminal) = Terminal::new(TestBackend::new(width, height));
    let Ok(_) = terminal.draw(|frame| draw(frame, model));
    let buffer = terminal.backend().buffer();
    let line = |y| (0..width).filter_map(|x| Some(buffer.cell((x, y))?.symbol())).collect::<String>();
    (0..height).map(|y| line(y).trim_end().to_owned()).collect()
}
