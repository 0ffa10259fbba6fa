//! The record of counts: a text file, one row a kernel.

use std::collections::BTreeMap;
use std::fmt::Write;

pub(crate) const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../benches/instructions.txt");

const HEAD: &str = "# Instructions a sample of each kernel, at the baseline of x86-64; `make guards` checks them.";

/// What the compiler made of the kernels.
#[derive(Clone, Debug, Default)]
pub(crate) struct Record {
    /// As it names itself.
    pub(crate) compiler: String,
    /// Kernel and instructions a sample, in order.
    pub(crate) rows: Vec<(String, u64)>,
}

impl Record {
    /// # Errors
    /// No file, or one that is not a record.
    pub(crate) fn read() -> Result<Self, String> {
        let text = std::fs::read_to_string(PATH).map_err(|error| format!("{PATH}: {error}"))?;
        let mut lines = text.lines().skip(1);
        let compiler = lines.next().unwrap_or_default().to_string();
        let row = |line: &str| {
            let (kernel, count) = line.rsplit_once(' ')?;
            Some((kernel.trim_end().to_string(), count.parse::<u64>().ok()?))
        };
        let rows: Result<_, String> =
            lines.map(|line| row(line).ok_or_else(|| format!("{PATH}: not a row: {line}"))).collect();
        Ok(Self { compiler, rows: rows? })
    }

    pub(crate) fn write(&self) -> Result<(), String> {
        let mut text = format!("{HEAD}\n{}\n", self.compiler);
        for (kernel, count) in &self.rows {
            writeln!(text, "{kernel:<48} {count:>10}").map_err(|error| error.to_string())?;
        }
        std::fs::write(PATH, text).map_err(|error| format!("{PATH}: {error}"))
    }

    /// A table of both, and how many counts are above `before` by more than `tolerance`, or not there.
    pub(crate) fn beside(&self, before: &Self, tolerance: f64) -> (String, usize) {
        let known: BTreeMap<_, _> = before.rows.iter().cloned().collect();
        let (mut table, mut lost) = (String::new(), 0);
        for (kernel, count) in &self.rows {
            let Some(recorded) = known.get(kernel) else {
                lost += 1;
                table += &format!("{kernel:<48} {count:>10}  not on record\n");
                continue;
            };
            let change = *count as f64 / *recorded as f64 - 1.0;
            let above = change > tolerance;
            lost += usize::from(above);
            let word = match change {
                _ if above => "  LOST",
                change if change < -tolerance => "  gained: `make guards WRITE=1`",
                _ => "",
            };
            table += &format!("{kernel:<48} {count:>10} {:>+7.1} %{word}\n", 100.0 * change);
        }
        (table, lost)
    }
}
