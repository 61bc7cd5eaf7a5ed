#![no_main]
libfuzzer_sys::fuzz_target!(init: gdp_fuzz::write_seeds("call"), |data: &[u8]| gdp_fuzz::call(data));
