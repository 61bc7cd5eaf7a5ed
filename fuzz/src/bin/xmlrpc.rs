#![no_main]
libfuzzer_sys::fuzz_target!(init: gdp_fuzz::write_seeds("xmlrpc"), |data: &[u8]| gdp_fuzz::xmlrpc(data));
