#!/bin/sh
# Puts the C library that is in a folder, its headers, its CMake package and its pkg-config file below a prefix.
set -eu
[ $# -eq 2 ] || { echo "usage: install.sh FOLDER-OF-THE-LIBRARY PREFIX" >&2; exit 2; }
library=$1 prefix=$2
here=$(cd "$(dirname "$0")" && pwd)
version=$(sed -n 's/^version = "\(.*\)"/\1/p' "$here/../../../Cargo.toml")
major=${version%%.*} minor=${version#*.} minor=${minor%%.*}

case $(uname -s) in
Darwin) shared=liblinkside.dylib static='-framework;CoreFoundation' libraries='-framework CoreFoundation' ;;
*) shared=liblinkside.so static='pthread;dl;m;gcc_s' libraries='-lpthread -ldl -lm -lgcc_s' ;;
esac
for file in "$shared" liblinkside.a; do
    [ -f "$library/$file" ] || { echo "no $file in $library: cargo build --release -p linkside-capi" >&2; exit 1; }
done

filled() { # a file, with what it is to say of the static library, and where it goes
    sed -e "s/@VERSION@/$version/; s/@MAJOR@/$major/; s/@MINOR@/$minor/; s/@SHARED@/$shared/; s/@STATIC@/$2/" "$here/$1.in" > "$3/$1"
}

package=$prefix/lib/cmake/linkside
mkdir -p "$prefix/include" "$package" "$prefix/lib/pkgconfig"
cp "$here"/../include/linkside.h "$here"/../include/linkside.hpp "$prefix/include"
cp "$library/$shared" "$library/liblinkside.a" "$prefix/lib"
filled linksideConfig.cmake "$static" "$package"
filled linksideConfigVersion.cmake "" "$package"
filled linkside.pc "$libraries" "$prefix/lib/pkgconfig"
