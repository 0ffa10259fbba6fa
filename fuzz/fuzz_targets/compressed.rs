#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| linkside_fuzz::bags::compressed(data));
