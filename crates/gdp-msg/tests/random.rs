//! Random types with random messages: every way round through the encodings leads back to the same
//! bytes, and damaged messages do no harm.

mod common;

use std::fmt::Write;

use common::{Ros1, Ros2, mapping, schema, transcode};
use gdp_msg::{Base, Count, Definition, Dialect, Encoding, Scalar, Schema};

const TYPES: u64 = 400;
const DAMAGED: usize = 40;

#[test]
fn every_way_round_leads_back() {
    for seed in 1..=TYPES {
        let mut random = Random(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let dialect = if random.below(2) == 0 { Ros1 } else { Ros2 };
        let text = definitions(dialect, &mut random);
        let schema = schema(dialect, &text);
        assert_eq!(Schema::from_bundle(&schema.bundle()).expect("its own bundle"), schema, "{text}");
        let mut json = String::new();
        message(&schema, schema.root(), &mut random, &mut json);
        let step = |from: Encoding, to: Encoding, input: &[u8]| {
            let done = transcode(&mapping(&schema, from, &schema, to), input);
            done.unwrap_or_else(|error| panic!("seed {seed}, {from} to {to}: {error}\n{text}\n{json}"))
        };
        let cdr = step(Encoding::Json, Encoding::Cdr, json.as_bytes());
        let canonical = step(Encoding::Cdr, Encoding::Json, &cdr);
        for way in [Encoding::CdrBigEndian, Encoding::Ros1, Encoding::Json] {
            let there = step(Encoding::Cdr, way, &cdr);
            assert_eq!(step(way, Encoding::Cdr, &there), cdr, "seed {seed}, by {way}\n{text}\n{json}");
            assert_eq!(step(way, Encoding::Json, &there), canonical, "seed {seed}, by {way}\n{text}\n{json}");
        }
        for from in [Encoding::Cdr, Encoding::Ros1, Encoding::Json] {
            let good = step(Encoding::Cdr, from, &cdr);
            for _ in 0..DAMAGED {
                let mut damaged = good.clone();
                let at = random.below(damaged.len().max(1) as u64) as usize;
                match random.below(3) {
                    0 => damaged.truncate(at),
                    1 => damaged.insert(at, random.below(256) as u8),
                    _ if damaged.is_empty() => {}
                    _ => damaged[at] = random.below(256) as u8,
                }
                // Either outcome is right; neither may panic, nor leave half a message.
                for to in [Encoding::Cdr, Encoding::Ros1, Encoding::Json] {
                    let _ = transcode(&mapping(&schema, from, &schema, to), &damaged);
                }
            }
        }
    }
}

/// Text of a type and of those it consists of: each uses only those behind it.
fn definitions(dialect: Dialect, random: &mut Random) -> String {
    let types = 1 + random.below(4);
    let mut text = String::new();
    for level in 0..types {
        if level > 0 {
            let _ = write!(text, "===\nMSG: test_msgs/T{level}\n");
        }
        for field in 0..random.below(6) {
            let base = base(dialect, level, types, random);
            let count = match random.below(8) {
                0 | 1 => "[]".into(),
                2 => format!("[{}]", 1 + random.below(4)),
                3 if dialect == Ros2 => format!("[<={}]", 1 + random.below(5)),
                _ => String::new(),
            };
            let _ = writeln!(text, "{base}{count} f{field}");
        }
    }
    text
}

fn base(dialect: Dialect, level: u64, types: u64, random: &mut Random) -> String {
    const SCALARS: [&str; 13] = [
        "bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32",
        "float64",
    ];
    match random.below(20) {
        0..13 => SCALARS[random.below(13) as usize].into(),
        13 | 14 => "string".into(),
        15 if dialect == Ros1 => ["time", "duration"][random.below(2) as usize].into(),
        15 => "wstring".into(),
        16 if dialect == Ros2 => format!("string<={}", 4 + random.below(9)),
        17 if dialect == Ros2 => format!("wstring<={}", 4 + random.below(9)),
        _ if level + 1 < types => format!("T{}", level + 1 + random.below(types - level - 1)),
        _ => "uint16".into(),
    }
}

fn message(schema: &Schema, definition: &Definition, random: &mut Random, json: &mut String) {
    json.push('{');
    for (index, field) in definition.fields.iter().enumerate() {
        let _ = write!(json, "{}\"{}\":", if index > 0 { "," } else { "" }, field.name);
        let length = match field.count {
            Count::One => {
                value(schema, &field.base, random, json);
                continue;
            }
            Count::Fixed(length) => length.into(),
            Count::Sequence(bound) => random.below(u64::from(bound.unwrap_or(5)) + 1),
        };
        json.push('[');
        let octets = matches!(field.base, Base::Scalar(Scalar::Byte));
        for element in 0..length {
            json.push_str(if element > 0 { "," } else { "" });
            let base = if octets { &Base::Scalar(Scalar::UInt8) } else { &field.base };
            value(schema, base, random, json);
        }
        json.push(']');
    }
    json.push('}');
}

fn value(schema: &Schema, base: &Base, random: &mut Random, json: &mut String) {
    let bits = random.next();
    let _ = match base {
        Base::Scalar(Scalar::Bool) => write!(json, "{}", bits.is_multiple_of(2)),
        Base::Scalar(Scalar::Byte) if schema.dialect() == Ros2 => write!(json, "{}", bits as u8),
        Base::Scalar(Scalar::Byte | Scalar::Int8) => write!(json, "{}", bits as i8),
        Base::Scalar(Scalar::Char | Scalar::UInt8) => write!(json, "{}", bits as u8),
        Base::Scalar(Scalar::Int16) => write!(json, "{}", bits as i16),
        Base::Scalar(Scalar::UInt16) => write!(json, "{}", bits as u16),
        Base::Scalar(Scalar::Int32) => write!(json, "{}", bits as i32),
        Base::Scalar(Scalar::UInt32) => write!(json, "{}", bits as u32),
        Base::Scalar(Scalar::Int64) => write!(json, "{}", bits as i64),
        Base::Scalar(Scalar::UInt64) => write!(json, "\"{bits}\""),
        Base::Scalar(Scalar::Float32) => float(json, f32::from_bits(bits as u32).into()),
        Base::Scalar(Scalar::Float64) => float(json, f64::from_bits(bits)),
        Base::String(_) | Base::WString(_) => {
            write!(json, "\"{}\"", ["", "a", "é", "日", "😀", "\\n\\\""][(bits % 6) as usize])
        }
        Base::Time => write!(json, r#"{{"secs":{},"nsecs":{}}}"#, bits as u32, bits >> 34),
        Base::Duration => write!(json, r#"{{"secs":{},"nsecs":{}}}"#, bits as i32, bits >> 34),
        Base::Named(name) => {
            let definition = schema.definitions().find(|definition| definition.name == *name).expect("a closed set");
            message(schema, definition, random, json);
            Ok(())
        }
    };
}

fn float(json: &mut String, value: f64) -> std::fmt::Result {
    if value.is_finite() { write!(json, "{value:e}") } else { write!(json, "\"NaN\"") }
}

/// xorshift64*.
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_f491_4f6c_dd1d)
    }

    fn below(&mut self, bound: u64) -> u64 {
        self.next() % bound
    }
}
