//! Turn, scale and shift of the plane.

use glam::DVec2;

/// The map x → scale · rotation · x + shift.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Similarity {
    /// Scale times cosine and sine of the turn.
    pub turn: DVec2,
    /// Where the origin goes.
    pub shift: DVec2,
}

impl Similarity {
    /// The map that leaves everything where it is.
    pub const IDENTITY: Self = Self { turn: DVec2::X, shift: DVec2::ZERO };

    /// The image of a point.
    #[inline(always)]
    pub fn apply(&self, p: DVec2) -> DVec2 {
        self.turned(p) + self.shift
    }

    #[inline(always)]
    fn turned(&self, p: DVec2) -> DVec2 {
        DVec2::new(self.turn.x * p.x - self.turn.y * p.y, self.turn.y * p.x + self.turn.x * p.y)
    }

    /// How many times longer everything becomes.
    pub fn scale(&self) -> f64 {
        self.turn.length_squared().sqrt()
    }

    /// The map back; not finite for scale 0.
    pub fn inverse(&self) -> Self {
        let turn = DVec2::new(self.turn.x, -self.turn.y) / self.turn.length_squared();
        let back = Self { turn, shift: DVec2::ZERO };
        Self { turn, shift: -back.turned(self.shift) }
    }

    /// First `other`, then this.
    pub fn after(&self, other: &Self) -> Self {
        Self { turn: self.turned(other.turn), shift: self.apply(other.shift) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_invert_and_follow_each_other() {
        let a = Similarity { turn: DVec2::new(0.8, -1.1), shift: DVec2::new(3.0, -7.0) };
        let b = Similarity { turn: DVec2::new(-0.3, 0.4), shift: DVec2::new(0.5, 12.0) };
        let p = DVec2::new(41.0, -5.5);
        assert!((a.inverse().apply(a.apply(p)) - p).length() < 1e-12);
        assert!((a.after(&b).apply(p) - a.apply(b.apply(p))).length() < 1e-12);
        assert!((b.scale() - 0.5).abs() < 1e-15);
        assert_eq!(Similarity::IDENTITY.apply(p), p);
    }
}
