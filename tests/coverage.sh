#!/bin/sh
# Lines of the Rust crates that their tests run. The argument is the version of LLVM, that of `rustc -vV`.
set -e
cd "$(dirname "$0")/.."
target=target/coverage
rm -rf "$target/profiles"
export RUSTFLAGS="--cfg one_level -Cinstrument-coverage" LLVM_PROFILE_FILE="$PWD/$target/profiles/%p-%m.profraw"
crates="-p linkside-core -p linkside-bag -p linkside-compiled -p linkside-capi"
# shellcheck disable=SC2086
cargo test --locked --target-dir "$target" $crates
# shellcheck disable=SC2086
programs=$(cargo test --locked --target-dir "$target" $crates --no-run --message-format=json 2> /dev/null |
    sed -n 's/.*"executable":"\([^"]*\)".*/--object=\1/p')
"llvm-profdata-$1" merge --sparse "$target"/profiles/*.profraw -o "$target/tests.profdata"
# shellcheck disable=SC2086
"llvm-cov-$1" report $programs --instr-profile="$target/tests.profdata" --ignore-filename-regex='registry|rustc|/tests/|/fuzz/'
