//! Results on standard output: a table for people or an array of objects for scripts.

use comfy_table::{Table, presets};
use serde::Serialize;

use crate::args::Output;

/// A row that knows its columns.
pub(crate) trait Row: Serialize {
    const COLUMNS: &'static [&'static str];

    fn cells(&self) -> Vec<String>;
}

/// Prints rows in the chosen form.
pub(crate) fn print<R: Row>(output: Output, rows: &[R]) -> anyhow::Result<()> {
    match output {
        Output::Json => println!("{}", serde_json::to_string_pretty(rows)?),
        Output::Table => {
            let mut table = Table::new();
            table.load_preset(presets::NOTHING);
            table.set_header(R::COLUMNS);
            for row in rows {
                table.add_row(row.cells());
            }
            println!("{table}");
        }
    }
    Ok(())
}

/// A figure for a cell; a dash where there is none.
pub(crate) fn figure(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |v| format!("{v:.digits$}"))
}

/// NaN means "not measured" on the wire and is absent here.
pub(crate) fn measured(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}

/// A dash for an empty text.
pub(crate) fn or_dash(text: &str) -> String {
    if text.is_empty() { "-" } else { text }.to_owned()
}

pub(crate) fn mebibytes(bytes: u64) -> String {
    format!("{:.1} MiB", bytes as f64 / (1 << 20) as f64)
}
