#![no_main]
libfuzzer_sys::fuzz_target!(init: gdp_fuzz::write_seeds("msg"), |data: &[u8]| gdp_fuzz::msg(data));
