//! The watercolor filter in plain f64, read straight from the paper. Nearest sites come from the Delaunay
//! triangulation of the sites, which knows nothing of the fast form's windows.

use super::cells::{Site, delaunay};
use super::{Config, initial};
use crate::kernel::contrast;
use crate::pixels::Rgb;
use spade::handles::FixedVertexHandle;
use spade::{Point2, Triangulation};

/// Draws `augmented` (camera picture with the models over it) as a first frame; 8-bit result.
pub fn reference(config: &Config, augmented: &Rgb) -> Rgb {
    let size = augmented.size();
    let mut out = Rgb::new(size, [0; 3]);
    let sites = match config.sites.sites() {
        Some(sites) => sites.to_vec(),
        None => initial(size, config.cell, config.seed),
    };
    let labels = labels(&sites, size.width, size.height);
    let mut sums = vec![([0.0; 3], 0.0); sites.len()];
    for (i, &label) in labels.iter().enumerate() {
        let (sum, count) = &mut sums[label];
        let color = augmented.at(i % size.width, i / size.width).map(|v| f64::from(v) / 255.0);
        *count += 1.0;
        for (sum, value) in sum.iter_mut().zip(color) {
            *sum += value;
        }
    }
    let (alpha, beta) = (f64::from(config.alpha), f64::from(config.beta));
    let yuv = [beta * (1.0 - alpha), beta * alpha / 2.0, beta * alpha / 2.0];
    for (i, &label) in labels.iter().enumerate() {
        let (x, y) = (i % size.width, i / size.width);
        let response = contrast::reference(augmented, x, y, yuv, (1.0 - beta) / 3.0);
        if response <= f64::from(config.threshold) {
            let (sum, count) = sums[label];
            out.set(x, y, sum.map(|v| ((v / count).clamp(0.0, 1.0) * 255.0 + 0.5).floor() as u8));
        }
    }
    out
}

/// Nearest site of every pixel, rows first; the lowest index among equals.
pub(super) fn labels(sites: &[[i32; 2]], width: usize, height: usize) -> Vec<usize> {
    let mesh = delaunay(sites);
    let mut hint: Option<FixedVertexHandle> = None;
    (0..width * height)
        .map(|i| {
            let at = Point2::new((i % width) as f64 + 0.5, (i / width) as f64 + 0.5);
            let distance = |p: Point2<f64>| (p.x - at.x) * (p.x - at.x) + (p.y - at.y) * (p.y - at.y);
            let Some(mut site) = hint.map(|h| mesh.vertex(h)).or_else(|| mesh.vertices().next()) else {
                return 0;
            };
            // a site that is not nearest has a Delaunay neighbor that is nearer, or as near with a lower index
            loop {
                let key =
                    |s: spade::handles::VertexHandle<'_, Site>| (distance(s.position()), s.data().index);
                let better = site.out_edges().map(|edge| edge.to()).filter(|&to| key(to) < key(site));
                match better.min_by(|&a, &b| key(a).partial_cmp(&key(b)).unwrap_or(std::cmp::Ordering::Equal))
                {
                    Some(next) => site = next,
                    None => break,
                }
            }
            hint = Some(site.fix());
            site.data().index
        })
        .collect()
}
