//! Changes to files, from a flipped bit to numbers that overflow.

use rand::{Rng, RngExt};

/// Bytes that mean something at a border of some type.
const BYTES: [u8; 8] = [0, 1, 0x7f, 0x80, 0xff, 0x20, b'0', b'9'];

/// Numbers that something may not be ready for.
const NUMBERS: [&str; 32] = [
    "0",
    "1",
    "-1",
    "2",
    "3",
    "7",
    "8",
    "15",
    "16",
    "63",
    "64",
    "65",
    "255",
    "256",
    "257",
    "1024",
    "4096",
    "8192",
    "65536",
    "2147483647",
    "4294967296",
    "1099511627776",
    "9223372036854775807",
    "18446744073709551614",
    "18446744073709551615",
    "-9223372036854775808",
    "0.5",
    "1e308",
    "-1e308",
    "5e-324",
    "1e-45",
    "3.5e38",
];

/// Words of the text formats.
const WORDS: [&str; 24] = [
    "null",
    "true",
    "[]",
    "{}",
    "\"\"",
    "[[[",
    "NaN",
    "inf",
    "\"linear\"",
    "\"coded\"",
    "\"../x.csv\"",
    "{\"gamma\": 10}",
    "{\"table\": [[0, 0], [0.5, 0.5], [1, 1]]}",
    "\"measurement\"",
    "\"concat\"",
    "\"estimate\"",
    "\"f\"",
    "\"all\"",
    "\"sigmoid\"",
    "{\"softplus\": 0}",
    "{\"leaky_relu\": 1e30}",
    "[4, 4, 4]",
    "\"log_exposure\"",
    ",\n",
];

/// Changes `data` a few times; `other` is a second file of its kind.
pub fn mutate(data: &mut Vec<u8>, other: &[u8], text: bool, rng: &mut impl Rng) {
    for _ in 0..1 + rng.random_range(0..4usize).pow(2) {
        once(data, other, text, rng);
    }
    data.truncate(1 << 20);
}

fn once(data: &mut Vec<u8>, other: &[u8], text: bool, rng: &mut impl Rng) {
    let len = data.len();
    if len == 0 {
        data.extend_from_slice(other);
        return;
    }
    let at = rng.random_range(0..len);
    let longest = if rng.random() { 16 } else { 256 };
    let span = at..(at + rng.random_range(1..=longest)).min(len);
    match rng.random_range(0..if text { 14 } else { 10 }) {
        0 => data[at] ^= 1 << rng.random_range(0..8),
        1 => data[at] = BYTES[rng.random_range(0..BYTES.len())],
        2 => data[at] = rng.random(),
        3 => drop(data.drain(span)),
        4 => {
            let copy = data[span].to_vec();
            data.splice(at..at, copy);
        }
        5 => {
            let from = rng.random_range(0..=other.len().saturating_sub(1));
            let part = other[from..(from + span.len()).min(other.len())].to_vec();
            data.splice(if rng.random() { at..at } else { span }, part);
        }
        6 if rng.random_range(0..4) == 0 => data.truncate(at),
        6 | 7 => {
            // A whole number of some width at its borders.
            let width = 1 << rng.random_range(0..4);
            let value: u64 = match rng.random_range(0..5) {
                0 => u64::MAX,
                1 => u64::MAX >> 1,
                2 => 1 << rng.random_range(0..64),
                3 => rng.random_range(0..300),
                _ => u64::MAX - rng.random_range(0..16),
            };
            let end = (at + width).min(len);
            data[at..end].copy_from_slice(&value.to_le_bytes()[..end - at]);
        }
        8 | 10..=11 => {
            // A number in letters, as JSON, CSV and the headers of binary files hold it.
            let digits = |b: &u8| b.is_ascii_digit();
            let Some(start) = data[at..].iter().position(digits).map(|found| at + found) else { return };
            let end = start + data[start..].iter().position(|b| !digits(b)).unwrap_or(len - start);
            let number = NUMBERS[rng.random_range(0..NUMBERS.len())];
            data.splice(start..end, number.bytes());
        }
        12 => {
            let word = WORDS[rng.random_range(0..WORDS.len())];
            data.splice(at..at, word.bytes());
        }
        13 => {
            // A word in the place of another.
            let quote = |b: &u8| *b == b'"';
            let Some(start) = data[at..].iter().position(quote).map(|found| at + found) else { return };
            let Some(end) = data[start + 1..].iter().position(quote).map(|found| start + found + 2) else {
                return;
            };
            let word = WORDS[rng.random_range(0..WORDS.len())];
            data.splice(start..end, word.bytes());
        }
        _ => data[at] = data[rng.random_range(0..len)],
    }
}
