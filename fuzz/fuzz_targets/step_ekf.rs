#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| linkside_fuzz::calls::step_ekf(data));
