//! Table I as pictures: a bar for each setup, with the times to the edge, of computing, and back.

use std::path::Path;

use anyhow::Result;
use clap::ValueEnum as _;
use gdp_tests::measure::figure::{Figure, Measure, Unit};
use gdp_tests::measure::plot;

use super::table_row::TableRow;
use super::trial::Trial;
use super::workload::Workload;

const TO_EDGE: &str = "at the edge";
const COMPUTED: &str = "computed";
const BACK: &str = "back";

/// Draws a picture for each workload.
pub fn draw(rows: &[TableRow], folder: &Path) -> Result<()> {
    let figures: Vec<Figure> =
        Workload::value_variants().iter().filter_map(|workload| figure(rows, *workload)).collect();
    plot::draw(&figures, folder)
}

fn figure(rows: &[TableRow], workload: Workload) -> Option<Figure> {
    let mut cases: Vec<(String, Vec<&Trial>)> = Vec::new();
    for row in rows.iter().filter(|row| row.of == workload) {
        let case = format!("{}, {} links", row.setup.describe(), row.links.name());
        match cases.iter_mut().find(|(known, _)| *known == case) {
            Some((_, trials)) => trials.push(&row.trial),
            None => cases.push((case, vec![&row.trial])),
        }
    }
    if cases.is_empty() {
        return None;
    }
    let measures = cases.iter().flat_map(|(case, trials)| {
        let until = |of: fn(&Trial) -> f64| trials.iter().map(|trial| of(trial)).collect();
        [
            Measure::new(TO_EDGE, case, until(|it| it.to_edge_ms.p50)),
            Measure::new(COMPUTED, case, until(|it| it.to_edge_ms.p50 + it.compute_ms.p50)),
            Measure::new(BACK, case, until(|it| it.to_edge_ms.p50 + it.compute_ms.p50 + it.to_robot_ms.p50)),
        ]
    });
    let name = match workload {
        Workload::Slam => "eval-slam",
        Workload::Motion => "eval-motion",
        Workload::Grasp => "eval-grasp",
        Workload::GraspSmall => "eval-grasp-small",
    };
    let title = format!("{}: medians", workload.describe());
    let figure = Figure::new(name, title, Unit::Milliseconds, measures.collect());
    Some(figure.stack([(TO_EDGE, "to the edge"), (COMPUTED, "computing"), (BACK, "to the robot")]))
}
