#!/bin/sh
# Builds the targets for libFuzzer with the stable compiler: the flags of cargo-fuzz, without the sanitizer, which needs
# nightly. Where that is, `cargo +nightly fuzz run TARGET` does the same with AddressSanitizer.
set -e
cd "$(dirname "$0")"
sancov="-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters"
sancov="$sancov -Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares"
export RUSTFLAGS="--cfg fuzzing --cfg one_level $sancov"
exec cargo build --locked --release --target "$(rustc --print host-tuple)" "$@"
