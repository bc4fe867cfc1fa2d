//! Animations, as far as they move cameras.

use super::accessor::{Accessor, Buffers};
use super::json::{self, Root};
use super::tree::{self, Placed};
use super::{checked, get, name_or};
use crate::import::limits::CAMERA_KEYS_MAX;
use crate::import::report::{Report, shown};
use crate::track::{Between, CameraTrack, Joint, Keys};
use glam::{DMat4, DQuat, DVec3};
use json::animation::{Interpolation, Property};
use std::collections::{BTreeMap, HashMap, HashSet};

/// Channels of one animation that move nodes: by node, what it has for translation, rotation and scale.
type Channels = BTreeMap<usize, [Option<usize>; 3]>;

/// A track for each of the `placed` cameras that an animation moves; where several do, the first of them.
pub(super) fn read(
    root: &Root,
    buffers: &Buffers,
    placed: &[Placed],
    report: &mut Report,
) -> Result<Vec<CameraTrack>, String> {
    let mut channels = Vec::with_capacity(root.animations.len());
    for (index, animation) in root.animations.iter().enumerate() {
        channels.push(by_node(root, animation).map_err(|what| format!("animations[{index}] {what}"))?);
    }
    // The first and the last animation that moves each node.
    let mut movers = HashMap::<usize, (usize, usize)>::new();
    for (index, channels) in channels.iter().enumerate() {
        for &node in channels.keys() {
            movers.entry(node).or_insert((index, index)).1 = index;
        }
    }
    let (mut tracks, mut keys) = (Vec::new(), 0);
    let mut of_cameras = HashSet::new();
    for camera in placed {
        of_cameras.extend(camera.chain.iter().copied());
        let moving = || camera.chain.iter().filter_map(|node| movers.get(node));
        let (first, last) = (moving().map(|of| of.0).min(), moving().map(|of| of.1).max());
        let Some(index) = first else { continue };
        let animation = &root.animations[index];
        let name = name_or(&animation.name, "animation", index);
        if last != first {
            report.warn(format!(
                "several animations move the camera \"{}\"; the first, \"{}\", is played",
                shown(&camera.name),
                shown(&name)
            ));
        }
        let of = |what: String| format!("animations[{index}] {what}");
        let track = track(root, buffers, camera, (animation, &channels[index]), name, &mut keys);
        tracks.push(track.map_err(of)?);
    }
    let is_left_out = |channels: &Channels| channels.keys().any(|node| !of_cameras.contains(node));
    if channels.iter().any(is_left_out) || root.animations.iter().any(has_weights) {
        report.warn("animations are played for cameras alone: everything else is shown in its rest pose");
    }
    Ok(tracks)
}

fn has_weights(animation: &json::Animation) -> bool {
    let is_weights = |channel: &json::animation::Channel| {
        matches!(checked(&channel.target.path), Ok(Property::MorphTargetWeights))
    };
    animation.channels.iter().any(is_weights)
}

/// The samplers of an animation by what they move. Weights of morph targets move no camera.
fn by_node(root: &Root, animation: &json::Animation) -> Result<Channels, String> {
    let mut channels = Channels::new();
    for (index, channel) in animation.channels.iter().enumerate() {
        let of = |what: String| format!("has channels[{index}], which {what}");
        let node = channel.target.node.value();
        get(&root.nodes, node, "nodes").map_err(of)?;
        let place = match checked(&channel.target.path).map_err(of)? {
            Property::Translation => 0,
            Property::Rotation => 1,
            Property::Scale => 2,
            Property::MorphTargetWeights => continue,
        };
        let slot = &mut channels.entry(node).or_default()[place];
        if slot.replace(channel.sampler.value()).is_some() {
            return Err(of(format!("moves nodes[{node}] in a way that another channel does")));
        }
    }
    Ok(channels)
}

fn track(
    root: &Root,
    buffers: &Buffers,
    camera: &Placed,
    (animation, channels): (&json::Animation, &Channels),
    name: String,
    keys_in_all: &mut usize,
) -> Result<CameraTrack, String> {
    let mut duration = 0.0_f64;
    let mut chain = Vec::with_capacity(camera.chain.len());
    for &index in &camera.chain {
        let node = get(&root.nodes, index, "nodes")?;
        let Some(&[translation, rotation, scale]) = channels.get(&index) else {
            chain.push(Joint::Still(tree::transform(node)?));
            continue;
        };
        if node.matrix.is_some() {
            return Err(format!(
                "moves nodes[{index}], which has a matrix; give it translation, rotation and scale"
            ));
        }
        let mut keys = |sampler: usize| {
            let keys = vectors(root, buffers, animation, sampler)
                .map_err(|what| format!("has samplers[{sampler}], which {what}"))?;
            duration = duration.max(keys.times.last().copied().unwrap_or(0.0));
            *keys_in_all += keys.values.len();
            if *keys_in_all > CAMERA_KEYS_MAX {
                return Err(format!("moves cameras by more than {CAMERA_KEYS_MAX} keys; thin them out"));
            }
            Ok::<_, String>(keys)
        };
        let (rest_scale, rest_rotation, rest_translation) = tree::parts(node)?;
        let vector = |[x, y, z, _]: [f64; 4]| DVec3::new(x, y, z);
        let translation = translation.map(|sampler| Ok(keys(sampler)?.with_lanes(3)?.map(vector)));
        let scale = scale.map(|sampler| Ok(keys(sampler)?.with_lanes(3)?.map(vector)));
        let rotation = rotation.map(|sampler| keys(sampler)?.with_lanes(4)?.rotations());
        chain.push(Joint::Moving {
            translation: or_rest(translation, rest_translation)?,
            rotation: or_rest(rotation, rest_rotation)?,
            scale: or_rest(scale, rest_scale)?,
        });
    }
    let (camera, fov_degrees) = (camera.name.clone(), camera.fov_degrees);
    Ok(CameraTrack { camera, animation: name, chain, to_world: DMat4::IDENTITY, fov_degrees, duration })
}

/// Keys, or where there are none what the node has at rest.
fn or_rest<V>(keys: Option<Result<Keys<V>, String>>, rest: V) -> Result<Result<Keys<V>, V>, String> {
    keys.transpose().map(|keys| keys.ok_or(rest))
}

/// A sampler's keys before it is known what they are.
struct Raw {
    times: Vec<f64>,
    values: Vec<[f64; 4]>,
    lanes: usize,
    between: Between,
}

fn vectors(
    root: &Root,
    buffers: &Buffers,
    animation: &json::Animation,
    sampler: usize,
) -> Result<Raw, String> {
    let sampler = get(&animation.samplers, sampler, "samplers")?;
    let between = match checked(&sampler.interpolation)? {
        Interpolation::Linear => Between::Line,
        Interpolation::Step => Between::Step,
        Interpolation::CubicSpline => Between::Spline,
    };
    let input = Accessor::open(root, buffers, sampler.input.value())?;
    let output = Accessor::open(root, buffers, sampler.output.value())?;
    if input.lanes() != 1 || !input.is_float_or_normalized() || !output.is_float_or_normalized() {
        return Err("has times that are no floats, or values that are integers".to_owned());
    }
    let each = if between == Between::Spline { 3 } else { 1 };
    if input.count() == 0 || input.count().checked_mul(each) != Some(output.count()) {
        return Err(format!("has {} times and {} values, {each} each", input.count(), output.count()));
    }
    let times: Vec<f64> = (0..input.count()).map(|key| f64::from(input.vector::<1>(key, 0.0)[0])).collect();
    let ascend = times.is_sorted_by(|a, b| a < b);
    if !ascend || !times.iter().all(|time| time.is_finite() && *time >= 0.0) {
        return Err("has times that do not ascend from 0".to_owned());
    }
    let values: Vec<[f64; 4]> =
        (0..output.count()).map(|key| output.vector::<4>(key, 0.0).map(f64::from)).collect();
    if values.iter().flatten().any(|number| !number.is_finite()) {
        return Err("has a value that is not finite".to_owned());
    }
    Ok(Raw { times, values, lanes: output.lanes(), between })
}

impl Raw {
    fn with_lanes(self, lanes: usize) -> Result<Self, String> {
        if self.lanes == lanes {
            return Ok(self);
        }
        Err(format!("has values of {} numbers where {lanes} are expected", self.lanes))
    }

    fn map<V>(self, value: impl Fn([f64; 4]) -> V) -> Keys<V> {
        let values = self.values.into_iter().map(value).collect();
        Keys { times: self.times, values, between: self.between }
    }

    /// Unit quaternions at the keys; tangents as they are.
    fn rotations(self) -> Result<Keys<DQuat>, String> {
        let has_tangents = self.between == Between::Spline;
        let mut keys = self.map(DQuat::from_array);
        for (place, value) in keys.values.iter_mut().enumerate() {
            if has_tangents && place % 3 != 1 {
                continue;
            }
            // The file's four numbers were rounded; in f64 they are not a unit quaternion any more.
            let length_squared = value.length_squared();
            if length_squared == 0.0 || !length_squared.is_finite() {
                return Err("has a rotation without direction".to_owned());
            }
            *value = value.normalize();
        }
        Ok(keys)
    }
}
