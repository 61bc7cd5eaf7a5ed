#![no_main]
libfuzzer_sys::fuzz_target!(init: gdp_fuzz::write_seeds("key_box"), |data: &[u8]| gdp_fuzz::key_box(data));
