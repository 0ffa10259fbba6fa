#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| linkside_fuzz::compiled::compiled_content(data));
