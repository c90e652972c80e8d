//! Small symmetric positive definite systems, solved in place on the stack.

/// Solves A·x = b for a symmetric positive definite A of which the lower triangle is read. `None` when A is
/// not safely positive definite (a pivot below 1e-14 of its diagonal) or something is not finite.
///
/// Cholesky factorization, Golub & Van Loan, Matrix Computations, algorithm 4.2.1.
pub fn solve_spd<const N: usize>(mut a: [[f64; N]; N], mut b: [f64; N]) -> Option<[f64; N]> {
    for j in 0..N {
        let mut pivot = a[j][j];
        let least = 1e-14 * pivot;
        for k in 0..j {
            pivot -= a[j][k] * a[j][k];
        }
        // written so that NaN is refused too
        if !(pivot > least && pivot > 0.0 && pivot.is_finite()) {
            return None;
        }
        let root = pivot.sqrt();
        a[j][j] = root;
        for i in j + 1..N {
            let mut sum = a[i][j];
            for k in 0..j {
                sum -= a[i][k] * a[j][k];
            }
            a[i][j] = sum / root;
        }
    }
    for i in 0..N {
        for k in 0..i {
            b[i] -= a[i][k] * b[k];
        }
        b[i] /= a[i][i];
    }
    for i in (0..N).rev() {
        for k in i + 1..N {
            b[i] -= a[k][i] * b[k];
        }
        b[i] /= a[i][i];
    }
    b.iter().all(|v| v.is_finite()).then_some(b)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pixels::SplitMix64;

    #[test]
    fn solutions_satisfy_their_systems() {
        let mut rng = SplitMix64::new(5);
        for _ in 0..1000 {
            let m: [[f64; 5]; 5] = std::array::from_fn(|_| std::array::from_fn(|_| rng.f64() - 0.5));
            let a: [[f64; 5]; 5] = std::array::from_fn(|i| {
                std::array::from_fn(|j| {
                    (0..5).map(|k| m[i][k] * m[j][k]).sum::<f64>() + f64::from(u8::from(i == j))
                })
            });
            let x: [f64; 5] = std::array::from_fn(|_| rng.f64());
            let b = std::array::from_fn(|i| (0..5).map(|j| a[i][j] * x[j]).sum());
            let solved = solve_spd(a, b).expect("positive definite");
            assert!(solved.iter().zip(x).all(|(s, x)| (s - x).abs() < 1e-12));
        }
    }

    #[test]
    fn singular_and_nonsense_are_refused() {
        assert!(solve_spd([[1.0, 1.0], [1.0, 1.0]], [1.0, 2.0]).is_none());
        assert!(solve_spd([[-1.0]], [1.0]).is_none());
        assert!(solve_spd([[f64::NAN]], [1.0]).is_none());
        assert!(solve_spd([[1.0]], [f64::INFINITY]).is_none());
    }
}
