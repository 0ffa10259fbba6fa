//! The header that is there is that of the functions that are there.

const GENERATED: &str = include_str!(concat!(env!("OUT_DIR"), "/linkside.h"));
const PATH: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/include/linkside.h");

#[test]
fn the_header_is_up_to_date() {
    if std::env::var_os("LINKSIDE_WRITE_HEADER").is_some() {
        std::fs::write(PATH, GENERATED).unwrap();
    }
    let there = std::fs::read_to_string(PATH).unwrap_or_default();
    assert!(there == GENERATED, "{PATH} is not what cbindgen makes of the source: `make header`");
}
