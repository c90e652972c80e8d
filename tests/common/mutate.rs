//! Harm done to good bytes: what the tests of every parser feed it.

use vernissage::pixels::SplitMix64;

/// Changes a few bytes, numbers or stretches.
pub fn mutate(bytes: &mut Vec<u8>, rng: &mut SplitMix64) {
    for _ in 0..rng.int(1, 4) {
        if bytes.is_empty() {
            return;
        }
        let at = rng.int(0, bytes.len() as i64 - 1) as usize;
        let end = (at + rng.int(1, 40) as usize).min(bytes.len());
        match rng.int(0, 7) {
            0 => bytes[at] = rng.next_u64() as u8,
            1 => bytes[at] ^= 1 << rng.int(0, 7),
            2 => drop(bytes.drain(at..end)),
            3 => {
                let again = bytes[at..end].to_vec();
                drop(bytes.splice(at..at, again));
            }
            4 => {
                let words = [0, u32::MAX, 1 << 31, i32::MAX as u32, 0x7f80_0000, 0x7fc0_0000, 1 << 24, 3];
                let word = words[rng.int(0, 7) as usize].to_le_bytes();
                let end = (at + 4).min(bytes.len());
                bytes[at..end].copy_from_slice(&word[..end - at]);
            }
            5 => {
                let words =
                    ["99999999", "-1", "4294967295", "1e999", "nan", "18446744073709551615", "0", "{}"];
                let word = words[rng.int(0, 7) as usize].bytes();
                // in place of a number, if there is one here
                let digit = |b: &u8| b.is_ascii_digit();
                let start = at + bytes[at..].iter().position(digit).unwrap_or(0);
                let end = start + bytes[start..].iter().take_while(|b| digit(b)).count();
                drop(bytes.splice(start..end, word));
            }
            6 => bytes[at] = *b" \n\r/\\#{}[]\",:-0"[..].get(rng.int(0, 14) as usize).unwrap_or(&0),
            _ => {
                let from = rng.int(0, bytes.len() as i64 - 1) as usize;
                let stretch = bytes[from..(from + end - at).min(bytes.len())].to_vec();
                let end = at + stretch.len().min(bytes.len() - at);
                bytes[at..end].copy_from_slice(&stretch[..end - at]);
            }
        }
    }
}
