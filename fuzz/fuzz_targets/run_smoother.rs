#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| linkside_fuzz::runs::run_smoother(data));
