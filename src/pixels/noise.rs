//! Repeatable randomness: SplitMix64 for initial grids and starts, a stateless hash for everything that
//! varies from frame to frame.

/// Steele, Lea & Flood's SplitMix64. The streams drawn from it are part of the file contracts.
#[derive(Clone, Debug)]
pub struct SplitMix64(u64);

impl SplitMix64 {
    /// Starts the stream of `seed`.
    pub fn new(seed: u64) -> Self {
        Self(seed)
    }

    /// The next 64 random bits.
    pub fn next_u64(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        mix(self.0)
    }

    /// Uniform in [0, 1), a multiple of 2⁻⁵³.
    pub fn f64(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform integer in `lo..=hi` by remainder; `lo` when `hi < lo`.
    pub fn int(&mut self, lo: i64, hi: i64) -> i64 {
        let span = (hi.saturating_sub(lo)).max(0) as u64 + 1;
        lo + (self.next_u64() % span) as i64
    }
}

fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// 64 bits that depend only on position, seed and frame number: noise without a running generator.
pub fn hash_noise(x: u32, y: u32, seed: u64, sequence: u64) -> u64 {
    let position = (u64::from(y) << 32) | u64::from(x);
    mix(mix(position ^ mix(seed)) ^ sequence.wrapping_mul(0x9e37_79b9_7f4a_7c15))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splitmix_gives_the_published_stream() {
        let mut rng = SplitMix64::new(1234567);
        let first: Vec<u64> = (0..3).map(|_| rng.next_u64()).collect();
        assert_eq!(first, [6457827717110365317, 3203168211198807973, 9817491932198370423]);
    }

    #[test]
    fn integers_stay_in_range() {
        let mut rng = SplitMix64::new(7);
        assert!((0..1000).map(|_| rng.int(-3, 3)).all(|v| (-3..=3).contains(&v)));
        assert_eq!(rng.int(5, 5), 5);
    }
}
