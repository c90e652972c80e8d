//! A solved rigid motion, marker → camera.

use glam::{DMat3, DVec3};

/// Where a marker stands before the camera: `X_cam = R·X_marker + t`, millimetres.
///
/// Marker space: origin at the center, x right, y up, z out of the print towards the viewer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Rotation R (orthonormal, determinant +1).
    pub rotation: DMat3,
    /// Translation t in mm.
    pub translation: DVec3,
}

impl Pose {
    /// The point of marker space in camera space.
    pub fn apply(&self, point: DVec3) -> DVec3 {
        self.rotation * point + self.translation
    }

    /// This motion after another one.
    pub fn after(&self, first: &Pose) -> Pose {
        Pose { rotation: self.rotation * first.rotation, translation: self.apply(first.translation) }
    }

    /// The way back.
    pub fn inverse(&self) -> Pose {
        let rotation = self.rotation.transpose();
        Pose { rotation, translation: -(rotation * self.translation) }
    }

    /// Angle of the rotation that takes this pose's orientation to the other's, radians in [0, π].
    pub fn angle_to(&self, other: &Pose) -> f64 {
        let delta = self.rotation.transpose() * other.rotation;
        let trace = delta.x_axis.x + delta.y_axis.y + delta.z_axis.z;
        // atan2 keeps its precision near 0, where acos loses half the digits
        let skew = DVec3::new(
            delta.y_axis.z - delta.z_axis.y,
            delta.z_axis.x - delta.x_axis.z,
            delta.x_axis.y - delta.y_axis.x,
        );
        libm::atan2(skew.length(), trace - 1.0)
    }
}
