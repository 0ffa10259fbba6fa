//! Instructions that kernels take, held to the record `benches/instructions.txt`: a loss of speed shows without a clock.
//!
//! This program runs itself under valgrind's callgrind, which counts what each kernel takes for few samples and for many; the
//! difference is what a sample takes. It is the build that is shipped, for several instruction sets, told to use the one that every
//! processor has: valgrind does not know all of AVX2. Counts are the same from run to run, and change with the compiler: with another
//! version of it than wrote the record nothing is checked.

#[path = "../arm.rs"]
mod arm;
mod count;
mod kernels;
mod record;

use record::Record;
use std::process::ExitCode;

/// By how much a count may be more than on record.
const TOLERANCE: f64 = 0.03;

fn main() -> ExitCode {
    if std::env::var_os(count::COUNTING).is_some() {
        kernels::run();
        return ExitCode::SUCCESS;
    }
    match check() {
        Ok(words) => {
            println!("{words}");
            ExitCode::SUCCESS
        }
        Err(words) => {
            eprintln!("{words}");
            ExitCode::FAILURE
        }
    }
}

/// What was found; an error if a kernel has become slower.
fn check() -> Result<String, String> {
    if let Some(reason) = count::unfit() {
        return Ok(format!("instructions were not counted: {reason}"));
    }
    let (compiler, writes) = (count::compiler()?, std::env::var_os("LINKSIDE_WRITE_GUARDS").is_some());
    let before = Record::read();
    if let (Ok(record), false) = (&before, writes)
        && record.compiler != compiler
    {
        return Ok(format!("instructions were not counted: the record is of {}, this is {compiler}", record.compiler));
    }
    let names = kernels::names();
    let rows = names.iter().map(|name| (*name).to_string()).zip(count::all(names.len())?).collect();
    let now = Record { compiler, rows };
    if writes {
        now.write()?;
    }
    let before = if writes { before.unwrap_or_default() } else { before? };
    let (table, lost) = now.beside(&before, TOLERANCE);
    match lost {
        _ if writes => Ok(format!("{table}written: {}", record::PATH)),
        0 => Ok(table),
        lost => Err(format!(
            "{table}{lost} counts are more than {} % above the record, or not on it; if they are to be, `make guards WRITE=1`",
            100.0 * TOLERANCE
        )),
    }
}
