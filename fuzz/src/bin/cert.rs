#![no_main]
libfuzzer_sys::fuzz_target!(|data: &[u8]| gdp_fuzz::cert(data));
