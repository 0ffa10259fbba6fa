//! One portable binary, and the widest instructions of the machine that it runs on.
//!
//! A kernel is written once, `#[inline(always)]` all the way down, and compiled for several levels. Without fused
//! multiply-add each level gives the same bits, so the choice is never visible in a result.
//!
//! The level is chosen for each [`phase`] of a sample (predict, linearise, update, report), which takes about a
//! nanosecond. A phase is a function of its own, never inlined into its caller: compilers need far more than twice as long
//! for a function that is twice as large, and what two loops share is compiled once.
#![allow(unsafe_code)] // calling a function compiled for instructions that the processor was asked for

use std::sync::LazyLock;

/// Instruction sets that kernels are compiled for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Level {
    /// What every processor of the target has.
    Baseline,
    /// x86-64 with AVX2: four numbers at a time.
    Avx2,
    /// x86-64 with AVX-512: eight numbers at a time.
    Avx512,
}

/// Something to be compiled for every level; `run` must be `#[inline(always)]`.
pub trait Kernel {
    /// What it returns.
    type Output;
    /// Whether it works on [lanes](crate::scalar::Lanes), for which AVX-512 pays.
    const LANES: bool = false;
    /// The work.
    fn run(self) -> Self::Output;

    /// The same where registers hold two numbers and are sixteen: what a kernel keeps in them has to be less.
    #[inline(always)]
    fn run_narrow(self) -> Self::Output
    where
        Self: Sized,
    {
        self.run()
    }
}

/// The level in use: the machine's widest, or the environment variable `LINKSIDE_SIMD`: `baseline`, or `avx2` at most.
#[inline]
pub fn level() -> Level {
    static LEVEL: LazyLock<Level> = LazyLock::new(|| {
        let forced = std::env::var("LINKSIDE_SIMD").unwrap_or_default().to_ascii_lowercase();
        match forced.as_str() {
            "baseline" => Level::Baseline,
            "avx2" => Level::Avx2.min(widest()),
            _ => widest(),
        }
    });
    *LEVEL
}

/// The level of this machine, asked once.
#[inline]
fn widest() -> Level {
    static WIDEST: LazyLock<Level> = LazyLock::new(detect);
    *WIDEST
}

#[cfg(all(target_arch = "x86_64", not(one_level)))]
fn detect() -> Level {
    use std::is_x86_feature_detected as has;
    if has!("avx512f") && has!("avx512dq") && has!("avx512vl") && has!("avx512bw") {
        Level::Avx512
    } else if has!("avx2") {
        Level::Avx2
    } else {
        Level::Baseline
    }
}

/// Other processors, and builds in a hurry (`--cfg one_level`), have one level.
#[cfg(any(not(target_arch = "x86_64"), one_level))]
fn detect() -> Level {
    Level::Baseline
}

/// Runs `kernel` with the instructions of [`level`], AVX2 at most unless it works on lanes.
#[inline]
pub fn phase<K: Kernel>(kernel: K) -> K::Output {
    if K::LANES { dispatch_lanes(level(), kernel) } else { dispatch(level(), kernel) }
}

/// Runs `kernel` with the instructions of `level`, AVX2 at most, or of what the machine has of them.
///
/// Kernels on single numbers gain nothing from wider registers, and each level is compiled on its own.
#[inline]
pub fn dispatch<K: Kernel>(level: Level, kernel: K) -> K::Output {
    match level.min(widest()) {
        Level::Baseline => kernel.baseline(),
        // SAFETY: `widest` has asked the processor.
        #[cfg(all(target_arch = "x86_64", not(one_level)))]
        Level::Avx2 | Level::Avx512 => unsafe { kernel.avx2() },
        #[cfg(any(not(target_arch = "x86_64"), one_level))]
        Level::Avx2 | Level::Avx512 => kernel.baseline(),
    }
}

/// As [`dispatch`], with AVX-512 where there is, for kernels on eight [lanes](crate::scalar::Lanes).
#[inline]
pub fn dispatch_lanes<K: Kernel>(level: Level, kernel: K) -> K::Output {
    match level.min(widest()) {
        // SAFETY: `widest` has asked the processor.
        #[cfg(all(target_arch = "x86_64", not(one_level)))]
        Level::Avx512 => unsafe { kernel.avx512() },
        narrower => dispatch(narrower, kernel),
    }
}

/// A kernel compiled for each level.
///
/// Methods of the kernel and not functions over kernels: rustc compiles these where they are written, all in one unit and by
/// one core, and methods where the kernel is.
trait Compiled: Kernel + Sized {
    #[inline(never)]
    fn baseline(self) -> Self::Output {
        if cfg!(target_arch = "x86_64") { self.run_narrow() } else { self.run() }
    }

    /// # Safety
    /// Of processors with AVX2 alone.
    #[cfg(all(target_arch = "x86_64", not(one_level)))]
    #[target_feature(enable = "avx2")]
    #[inline(never)]
    unsafe fn avx2(self) -> Self::Output {
        self.run()
    }

    /// # Safety
    /// Of processors with AVX-512 alone.
    #[cfg(all(target_arch = "x86_64", not(one_level)))]
    #[target_feature(enable = "avx512f,avx512dq,avx512vl,avx512bw")]
    #[inline(never)]
    unsafe fn avx512(self) -> Self::Output {
        self.run()
    }
}

impl<K: Kernel> Compiled for K {}
