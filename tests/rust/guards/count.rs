//! Counting under callgrind.

use core::hint::black_box;
use std::path::Path;
use std::process::Command;

/// Set in the environment of the program that is counted.
pub(crate) const COUNTING: &str = "LINKSIDE_GUARDS";

/// Samples of the two runs of each kernel; their difference leaves out what a run takes but once.
pub(crate) const LENGTHS: [usize; 2] = [20, 60];

/// [`counted_work`], as callgrind calls it.
const COUNTED: &str = concat!(module_path!(), "::counted_work");

/// Does `work` on `samples`; what callgrind collects is what is done in here.
#[inline(never)]
pub(crate) fn counted_work(work: &mut dyn FnMut(usize), samples: usize) {
    work(samples);
    black_box(samples); // else the call would be a jump, after which callgrind sees no return
}

/// Why counts of this program would say nothing of the kernels that are shipped.
pub(crate) fn unfit() -> Option<&'static str> {
    let overridden = std::env::vars_os().any(|(name, _)| name.to_string_lossy().starts_with("CARGO_PROFILE_RELEASE_"));
    let found = Command::new("valgrind").arg("--version").output();
    match () {
        () if cfg!(debug_assertions) => Some("this is a debug build"),
        () if cfg!(not(target_arch = "x86_64")) => Some("the record is of x86-64"),
        () if cfg!(target_feature = "avx") => Some("the build is for this kind of processor alone"),
        () if overridden => Some("the release profile is overridden"),
        () if !found.is_ok_and(|output| output.status.success()) => Some("there is no valgrind"),
        () => None,
    }
}

/// The compiler as it names itself.
pub(crate) fn compiler() -> Result<String, String> {
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output =
        Command::new(&rustc).arg("--version").output().map_err(|error| format!("{}: {error}", rustc.display()))?;
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_string())
}

/// Instructions a sample of each of so many kernels, in order: runs this program once under callgrind, which writes a file for
/// each call of [`counted_work`].
pub(crate) fn all(kernels: usize) -> Result<Vec<u64>, String> {
    let folder = std::env::temp_dir().join(format!("linkside-guards-{}", std::process::id()));
    std::fs::create_dir_all(&folder).map_err(|error| format!("{}: {error}", folder.display()))?;
    let counts = in_folder(kernels, &folder);
    let _ = std::fs::remove_dir_all(&folder);
    counts
}

fn in_folder(kernels: usize, folder: &Path) -> Result<Vec<u64>, String> {
    let own = std::env::current_exe().map_err(|error| error.to_string())?;
    let output = Command::new("valgrind")
        .arg("--tool=callgrind")
        .args(["--toggle-collect", "--dump-after"].map(|option| format!("{option}={COUNTED}")))
        .arg(format!("--callgrind-out-file={}/counts", folder.display()))
        .arg(own)
        .env(COUNTING, "")
        .env("LINKSIDE_SIMD", "baseline")
        // Filling memory by one instruction that repeats counts by bytes, and processors differ in when it is chosen.
        .env(
            "GLIBC_TUNABLES",
            "glibc.cpu.x86_rep_stosb_threshold=100000000:glibc.cpu.x86_rep_movsb_threshold=100000000",
        )
        .env("RAYON_NUM_THREADS", "1") // threads that wait for each other count as they please
        .output()
        .map_err(|error| format!("valgrind: {error}"))?;
    if !output.status.success() {
        return Err(format!("valgrind: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let collected = |i: usize| {
        let path = folder.join(format!("counts.{i}"));
        let text = std::fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        let total = text.lines().find_map(|line| line.strip_prefix("totals: "));
        total.and_then(|total| total.trim().parse::<u64>().ok()).ok_or_else(|| format!("{}: no totals", path.display()))
    };
    let [short, long] = LENGTHS;
    (0..kernels).map(|k| Ok((collected(2 * k + 2)? - collected(2 * k + 1)?) / (long - short) as u64)).collect()
}
