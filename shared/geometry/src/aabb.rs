use crate::{Ray, Vec3, rounding::gamma};

/// An axis-aligned box; empty when any `min` exceeds its `max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Low corner.
    pub min: Vec3,
    /// High corner.
    pub max: Vec3,
}

impl Aabb {
    /// The box that holds nothing.
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// Factors by which [`Aabb::clip`] shortens near ends and lengthens far ends.
    pub const SHORTEN: f32 = 1.0 - 2.0 * gamma(3);
    #[allow(missing_docs, reason = "said above")]
    pub const LENGTHEN: f32 = 1.0 + 2.0 * gamma(3);

    /// The smallest box around `points`.
    pub fn around(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| Self { min: b.min.min(p), max: b.max.max(p) })
    }

    /// Whether no point lies inside.
    pub fn is_empty(&self) -> bool {
        !(self.min.x <= self.max.x && self.min.y <= self.max.y && self.min.z <= self.max.z)
    }

    /// Edge lengths; meaningless for an empty box.
    pub fn extent(&self) -> Vec3 {
        self.max - self.min
    }

    /// The part `[t0, t1]` of `[ray.t_min, ray.t_max]` inside the box, or `None` when the ray misses it.
    ///
    /// `inverse` is `1 / direction` per axis, infinite where the direction is 0. Conservative: near ends are shortened and far ends
    /// lengthened by `2 gamma(3)`, twice the rounding error of the three operations behind a distance (Pharr, Jakob, Humphreys,
    /// *Physically Based Rendering*, section 6.8.2), so neither a ray that meets the box nor a hit at either end is turned away.
    #[inline]
    pub fn clip(&self, ray: &Ray, inverse: Vec3) -> Option<(f32, f32)> {
        let (mut t0, mut t1) = (ray.t_min, ray.t_max);
        for axis in 0..3 {
            let mut near = (self.min[axis] - ray.origin[axis]) * inverse[axis];
            let mut far = (self.max[axis] - ray.origin[axis]) * inverse[axis];
            if inverse[axis] < 0.0 {
                (near, far) = (far, near);
            }
            // An origin in a face with a parallel ray gives 0 * inf = NaN, which these comparisons pass over.
            let (near, far) = (near * Self::SHORTEN, far * Self::LENGTHEN);
            t0 = if near > t0 { near } else { t0 };
            t1 = if far < t1 { far } else { t1 };
        }
        (t0 <= t1).then_some((t0, t1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CUBE: Aabb = Aabb { min: Vec3::NEG_ONE, max: Vec3::ONE };

    fn clip(bounds: &Aabb, origin: Vec3, direction: Vec3) -> Option<(f32, f32)> {
        bounds.clip(&Ray { origin, direction, t_min: 0.0, t_max: 100.0 }, direction.recip())
    }

    #[test]
    fn a_ray_is_cut_to_the_box_and_to_its_own_range() {
        let (t0, t1) = clip(&CUBE, Vec3::new(-3.0, 0.5, 0.0), Vec3::X).unwrap();
        assert!((1.999_99..=2.0).contains(&t0), "{t0}");
        assert!((4.0..4.000_01).contains(&t1), "{t1}");
        assert_eq!(clip(&CUBE, Vec3::ZERO, Vec3::Y).unwrap().0, 0.0);
        assert_eq!(clip(&CUBE, Vec3::new(3.0, 0.0, 0.0), Vec3::X), None, "behind");
        assert_eq!(clip(&CUBE, Vec3::new(-3.0, 1.5, 0.0), Vec3::X), None, "beside");
    }

    #[test]
    fn parallel_rays_in_a_face_meet_the_box_from_either_sign_of_zero() {
        for zero in [0.0, -0.0] {
            for y in [-1.0, 1.0] {
                let direction = Vec3::new(1.0, zero, zero);
                assert!(clip(&CUBE, Vec3::new(-3.0, y, 1.0), direction).is_some(), "zero {zero}, face {y}");
            }
        }
    }

    #[test]
    fn flat_boxes_are_not_empty() {
        let flat = Aabb { min: Vec3::ZERO, max: Vec3::new(2.0, 3.0, 0.0) };
        assert!(!flat.is_empty() && Aabb::EMPTY.is_empty());
        assert_eq!(Aabb::around([Vec3::ZERO, Vec3::new(2.0, 3.0, 0.0)]), flat);
    }
}
