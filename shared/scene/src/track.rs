//! Cameras that move.

use glam::{DMat4, DQuat, DVec3};
use tessera_geometry::CameraPose;

/// A camera that an animation moves: keys of its node and of those above it.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraTrack {
    /// The camera's name, as in [`crate::Scene::cameras`].
    pub camera: String,
    /// The animation's name, for messages.
    pub animation: String,
    /// From the topmost node that matters down to the camera's.
    pub(crate) chain: Vec<Joint>,
    /// What the topmost node's parent is turned by.
    pub(crate) to_world: DMat4,
    pub(crate) fov_degrees: f64,
    /// The last key's time in seconds.
    pub(crate) duration: f64,
}

/// A node of the chain: at rest, or moved.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Joint {
    /// All the time.
    Still(DMat4),
    /// What has no keys keeps its place.
    Moving {
        translation: Result<Keys<DVec3>, DVec3>,
        rotation: Result<Keys<DQuat>, DQuat>,
        scale: Result<Keys<DVec3>, DVec3>,
    },
}

/// Values over time; before the first key it is that, after the last one that.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Keys<V> {
    /// In seconds, ascending, at least one.
    pub(crate) times: Vec<f64>,
    /// One a key; with tangents three: the one that leads to it, the value, the one that leads away.
    pub(crate) values: Vec<V>,
    pub(crate) between: Between,
}

/// What is between two keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Between {
    /// The shortest way at a constant speed.
    Line,
    /// The earlier one.
    Step,
    /// A cubic Hermite spline.
    Spline,
}

impl CameraTrack {
    /// The last key's time in seconds; nothing moves after it.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// The view at a time in seconds; `None` where the animation turns it into none, as with a scale of 0.
    pub fn pose_at(&self, seconds: f64) -> Option<CameraPose> {
        let to_world = self.chain.iter().fold(self.to_world, |above, joint| above * joint.at(seconds));
        pose_of(&to_world, self.fov_degrees)
    }
}

/// The view of a camera that looks along -z, as glTF's do.
pub(crate) fn pose_of(to_world: &DMat4, fov_degrees: f64) -> Option<CameraPose> {
    let eye = to_world.transform_point3(DVec3::ZERO);
    let forward = to_world.transform_vector3(DVec3::NEG_Z).try_normalize()?;
    let up = to_world.transform_vector3(DVec3::Y).try_normalize()?;
    eye.is_finite().then_some(CameraPose { eye, target: eye + forward, up, fov_degrees })
}

impl Joint {
    fn at(&self, seconds: f64) -> DMat4 {
        match self {
            Self::Still(transform) => *transform,
            Self::Moving { translation, rotation, scale } => {
                let vector = |keys: &Result<Keys<DVec3>, DVec3>| match keys {
                    Ok(keys) => keys.at(seconds),
                    Err(rest) => *rest,
                };
                let rotation = match rotation {
                    Ok(keys) => keys.at(seconds),
                    Err(rest) => *rest,
                };
                DMat4::from_scale_rotation_translation(vector(scale), rotation, vector(translation))
            }
        }
    }
}

/// What can be between two keys.
pub(crate) trait Value: Copy {
    /// From `self` to `to`, `part` of the way.
    fn toward(self, to: Self, part: f64) -> Self;
    /// Weighted.
    fn sum(terms: [(f64, Self); 4]) -> Self;
}

impl Value for DVec3 {
    fn toward(self, to: Self, part: f64) -> Self {
        self + (to - self) * part
    }

    fn sum(terms: [(f64, Self); 4]) -> Self {
        terms.into_iter().fold(Self::ZERO, |sum, (weight, term)| sum + term * weight)
    }
}

impl Value for DQuat {
    fn toward(self, to: Self, part: f64) -> Self {
        // A rotation is two quaternions: take the nearer one.
        let (to, cosine) = match self.dot(to) {
            cosine if cosine < 0.0 => (-to, -cosine),
            cosine => (to, cosine),
        };
        // Below an angle of 1e-4 the arc is its chord to within 1e-9 of it, and the quotient of sines would lose half its digits.
        if cosine > 1.0 - 5e-9 {
            return (self * (1.0 - part) + to * part).normalize();
        }
        let angle = libm::acos(cosine.min(1.0));
        let (before, after) = (libm::sin((1.0 - part) * angle), libm::sin(part * angle));
        ((self * before + to * after) / libm::sin(angle)).normalize()
    }

    fn sum(terms: [(f64, Self); 4]) -> Self {
        let zero = Self::from_xyzw(0.0, 0.0, 0.0, 0.0);
        let sum = terms.into_iter().fold(zero, |sum, (weight, term)| sum + term * weight);
        // (Opposite keys may meet in none.)
        if sum.length_squared() > 0.0 { sum.normalize() } else { Self::IDENTITY }
    }
}

impl<V: Value> Keys<V> {
    fn at(&self, seconds: f64) -> V {
        let place = |key: usize| if self.between == Between::Spline { 3 * key + 1 } else { key };
        let after = self.times.partition_point(|&time| time <= seconds);
        if after == 0 || after == self.times.len() {
            // (A spline's values are normalised between keys alone.)
            let key = place(after.saturating_sub(1));
            return self.values[key].toward(self.values[key], 0.0);
        }
        let before = after - 1;
        let step = self.times[after] - self.times[before];
        let part = (seconds - self.times[before]) / step;
        let (from, to) = (self.values[place(before)], self.values[place(after)]);
        match self.between {
            Between::Step => from,
            Between::Line => from.toward(to, part),
            Between::Spline => {
                // Hermite's basis, as in the standard's appendix C; tangents are a second's.
                let (out_of, into) = (self.values[place(before) + 1], self.values[place(after) - 1]);
                let (squared, cubed) = (part * part, part * part * part);
                V::sum([
                    (2.0 * cubed - 3.0 * squared + 1.0, from),
                    (step * (cubed - 2.0 * squared + part), out_of),
                    (-2.0 * cubed + 3.0 * squared, to),
                    (step * (cubed - squared), into),
                ])
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn near(a: DVec3, b: DVec3) -> bool {
        (a - b).length() < 1e-12
    }

    #[test]
    fn vectors_between_keys() {
        let (a, b) = (DVec3::new(1.0, 2.0, 3.0), DVec3::new(3.0, 0.0, 3.0));
        let mut keys = Keys { times: vec![1.0, 3.0], values: vec![a, b], between: Between::Line };
        for (seconds, expected) in [(0.0, a), (1.0, a), (1.5, a + (b - a) * 0.25), (3.0, b), (9.0, b)] {
            assert!(near(keys.at(seconds), expected), "{seconds}");
        }
        keys.between = Between::Step;
        assert_eq!([keys.at(2.999), keys.at(3.0)], [a, b]);
        // With tangents along the line it is the line.
        let slope = (b - a) / 2.0;
        let values = vec![DVec3::ZERO, a, slope, slope, b, DVec3::ZERO];
        let keys = Keys { values, between: Between::Spline, ..keys };
        for (seconds, part) in [(0.5, 0.0), (1.0, 0.0), (1.5, 0.25), (2.0, 0.5), (3.0, 1.0)] {
            assert!(near(keys.at(seconds), a + (b - a) * part), "{seconds}");
        }
    }

    #[test]
    fn rotations_take_the_shorter_way_at_a_constant_speed() {
        let quarter = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2);
        for to in [quarter, -quarter] {
            let keys =
                Keys { times: vec![0.0, 3.0], values: vec![DQuat::IDENTITY, to], between: Between::Line };
            let third = keys.at(1.0) * DVec3::Z;
            let expected = DQuat::from_rotation_y(std::f64::consts::FRAC_PI_6) * DVec3::Z;
            assert!(near(third, expected), "{third}");
        }
        let same = Keys { times: vec![0.0, 3.0], values: vec![quarter, quarter], between: Between::Line };
        assert!(near(same.at(1.0) * DVec3::Z, quarter * DVec3::Z));
        // A spline's numbers are no rotation before they are normalised.
        let none = DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0);
        let values = vec![none, DQuat::IDENTITY, none, none, quarter, none];
        let spline = Keys { times: vec![0.0, 1.0], values, between: Between::Spline };
        assert!((spline.at(0.5).length() - 1.0).abs() < 1e-12);
        assert!(near(
            spline.at(0.5) * DVec3::Z,
            DQuat::from_rotation_y(std::f64::consts::FRAC_PI_4) * DVec3::Z
        ));
    }

    #[test]
    fn a_camera_goes_where_the_nodes_above_it_go() {
        let turn = Keys {
            times: vec![0.0, 1.0],
            values: vec![DQuat::IDENTITY, DQuat::from_rotation_y(std::f64::consts::FRAC_PI_2)],
            between: Between::Line,
        };
        let arm = Joint::Moving { translation: Err(DVec3::ZERO), rotation: Ok(turn), scale: Err(DVec3::ONE) };
        let track = CameraTrack {
            camera: "c".into(),
            animation: "a".into(),
            chain: vec![arm, Joint::Still(DMat4::from_translation(DVec3::Z * 2.0))],
            to_world: DMat4::from_translation(DVec3::Y),
            fov_degrees: 40.0,
            duration: 1.0,
        };
        let start = track.pose_at(0.0).unwrap();
        assert!(near(start.eye, DVec3::new(0.0, 1.0, 2.0)) && near(start.target - start.eye, -DVec3::Z));
        let end = track.pose_at(1.0).unwrap();
        assert!(near(end.eye, DVec3::new(2.0, 1.0, 0.0)) && near(end.target - end.eye, -DVec3::X));
        assert_eq!(end.fov_degrees, 40.0);
    }
}
