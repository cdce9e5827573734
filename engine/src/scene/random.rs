//! Counter-based random numbers: every draw is a pure function of (seed, sample index, attempt, draw number).
//!
//! The generator is Philox4x32-10 (Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011), chosen because it
//! needs no state, so that a rejected attempt cannot shift the draws of a later one. The ranges are our own and use exact
//! arithmetic only, so a draw is bit-equal on every machine.

const MULTIPLIER_0: u32 = 0xD251_1F53;
const MULTIPLIER_1: u32 = 0xCD9E_8D57;
/// Key increments: the golden ratio and sqrt(3) - 1 in 32 bits (the paper's Weyl sequence).
const WEYL_0: u32 = 0x9E37_79B9;
const WEYL_1: u32 = 0xBB67_AE85;
const ROUNDS: u32 = 10;

/// The sequence of draws of one attempt.
#[derive(Clone, Debug)]
pub struct Draws {
    key: [u32; 2],
    index: u64,
    attempt: u32,
    next_draw: u32,
}

impl Draws {
    pub fn new(seed: u64, index: u64, attempt: u32) -> Self {
        Self {
            key: halves(seed),
            index,
            attempt,
            next_draw: 0,
        }
    }

    /// The next 64 random bits.
    pub fn bits(&mut self) -> u64 {
        let [index_low, index_high] = halves(self.index);
        let counter = [self.next_draw, self.attempt, index_low, index_high];
        self.next_draw = self.next_draw.wrapping_add(1);
        let out = philox(counter, self.key);
        u64::from(out[0]) | (u64::from(out[1]) << 32)
    }

    /// Uniform in [0, 1): a multiple of 2^-53.
    pub fn unit(&mut self) -> f64 {
        const SCALE: f64 = 1.0 / (1u64 << 53) as f64;
        (self.bits() >> 11) as f64 * SCALE
    }

    /// Uniform in [low, high); `low` if the range is empty.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// Uniform in [-limit, limit).
    pub fn jitter(&mut self, limit: f64) -> f64 {
        self.uniform(-limit, limit)
    }

    /// Uniform in 0..count. The bias is below count / 2^64.
    pub fn below(&mut self, count: usize) -> usize {
        assert!(count > 0, "cannot draw from an empty range");
        ((u128::from(self.bits()) * count as u128) >> 64) as usize
    }

    /// Uniform in low..=high.
    pub fn between(&mut self, low: u32, high: u32) -> u32 {
        assert!(low <= high, "range {low}..={high} is empty");
        low + self.below((high - low) as usize + 1) as u32
    }

    pub fn chance(&mut self, probability: f64) -> bool {
        self.unit() < probability
    }
}

fn halves(bits: u64) -> [u32; 2] {
    [bits as u32, (bits >> 32) as u32]
}

fn philox(mut counter: [u32; 4], mut key: [u32; 2]) -> [u32; 4] {
    for _ in 0..ROUNDS {
        let [low_0, high_0] = halves(u64::from(MULTIPLIER_0) * u64::from(counter[0]));
        let [low_1, high_1] = halves(u64::from(MULTIPLIER_1) * u64::from(counter[2]));
        counter = [
            high_1 ^ counter[1] ^ key[0],
            low_1,
            high_0 ^ counter[3] ^ key[1],
            low_0,
        ];
        key[0] = key[0].wrapping_add(WEYL_0);
        key[1] = key[1].wrapping_add(WEYL_1);
    }
    counter
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Known answers published with the Random123 library (`kat_vectors`).
    #[test]
    fn philox_gives_the_published_vectors() {
        assert_eq!(
            philox([0; 4], [0; 2]),
            [0x6627_e8d5, 0xe169_c58d, 0xbc57_ac4c, 0x9b00_dbd8]
        );
        assert_eq!(
            philox([u32::MAX; 4], [u32::MAX; 2]),
            [0x408f_276d, 0x41c8_3b0e, 0xa20b_c7c6, 0x6d54_51fd]
        );
        assert_eq!(
            philox(
                [0x243f_6a88, 0x85a3_08d3, 0x1319_8a2e, 0x0370_7344],
                [0xa409_3822, 0x299f_31d0]
            ),
            [0xd16c_fe09, 0x94fd_cceb, 0x5001_e420, 0x2412_6ea1]
        );
    }

    #[test]
    fn a_later_attempt_does_not_depend_on_draws_of_an_earlier_one() {
        let mut first = Draws::new(7, 3, 0);
        let untouched = Draws::new(7, 3, 1).bits();
        for _ in 0..100 {
            first.bits();
        }
        assert_eq!(Draws::new(7, 3, 1).bits(), untouched);
        assert_ne!(Draws::new(7, 3, 0).bits(), untouched);
        assert_ne!(Draws::new(8, 3, 1).bits(), untouched);
        assert_ne!(Draws::new(7, 4, 1).bits(), untouched);
    }

    #[test]
    fn ranges_are_covered_evenly() {
        let mut counts = [0u32; 5];
        let mut sum = 0.0;
        let mut draws = Draws::new(1, 2, 3);
        for _ in 0..50_000 {
            counts[draws.below(5)] += 1;
            let x = draws.uniform(-2.0, 6.0);
            assert!((-2.0..6.0).contains(&x));
            sum += x;
        }
        for count in counts {
            assert!(count.abs_diff(10_000) < 400, "{counts:?}");
        }
        assert!(
            (sum / 50_000.0 - 2.0).abs() < 0.05,
            "mean {}",
            sum / 50_000.0
        );
        assert_eq!(draws.between(4, 4), 4);
    }
}
