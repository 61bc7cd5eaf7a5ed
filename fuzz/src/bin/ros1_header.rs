#![no_main]
libfuzzer_sys::fuzz_target!(init: gdp_fuzz::write_seeds("ros1_header"), |data: &[u8]| gdp_fuzz::ros1_header(data));
