//! Writes `linkside.h` of what is in `src`, where it is to be compared with the one in `include`.

fn main() {
    println!("cargo:rerun-if-changed=src");
    println!("cargo:rerun-if-changed=cbindgen.toml");
    #[cfg(feature = "header")]
    header();
}

#[cfg(feature = "header")]
fn header() {
    let path = |name: &str| std::path::PathBuf::from(std::env::var_os(name).expect("cargo says it"));
    let bindings = cbindgen::generate(path("CARGO_MANIFEST_DIR")).expect("the interface can be said in C");
    bindings.write_to_file(path("OUT_DIR").join("linkside.h"));
}
