//! The node tree of the scene that is shown, with its lights and cameras.

use super::json::{self, Root};
use super::{checked, get, name_or};
use crate::import::limits::{CAMERA_CHAINS_MAX, COORDINATE_MAX, NODE_DEPTH_MAX};
use crate::import::report::{Report, shown};
use crate::track::pose_of;
use crate::{Camera, Light, LightKind, Node, Scene};
use glam::{DMat4, DQuat, DVec3, DVec4};
use json::extensions::scene::khr_lights_punctual;
use std::collections::{HashMap, HashSet};

/// A camera and the nodes that place it.
pub(super) struct Placed {
    pub(super) name: String,
    pub(super) fov_degrees: f64,
    /// From its root to its own.
    pub(super) chain: Vec<usize>,
}

/// Adds nodes (depth first, in file order), lights and cameras to `scene`; where the cameras are.
pub(super) fn read(root: &Root, scene: &mut Scene, report: &mut Report) -> Result<Vec<Placed>, String> {
    let (mut placed, mut in_chains) = (Vec::new(), 0);
    let parents = parents(root)?;
    let roots = roots(root, &parents, report)?;
    let mut camera_names = Names::default();
    // One entry a node that is still to come: its index in the file, its parent in `scene`, the parent's matrix, its level.
    let mut stack: Vec<(usize, Option<usize>, DMat4, usize)> =
        roots.iter().rev().map(|&index| (index, None, DMat4::IDENTITY, 1)).collect();
    while let Some((index, parent, to_parent, depth)) = stack.pop() {
        if depth > NODE_DEPTH_MAX {
            return Err(format!(
                "nodes[{index}] lies deeper than {NODE_DEPTH_MAX} levels; flatten the node tree"
            ));
        }
        let source = get(&root.nodes, index, "nodes")?;
        let of = |what: String| format!("nodes[{index}] {what}");
        let transform = transform(source).map_err(of)?;
        let to_world = to_parent * transform;
        if !to_world.is_finite() {
            return Err(of("has a transform that overflows".to_owned()));
        }
        let mesh = source.mesh.map(|mesh| mesh.value());
        if mesh.is_some_and(|mesh| mesh >= scene.meshes.len()) {
            return Err(of(format!("names a mesh beyond the {} there are", scene.meshes.len())));
        }
        let place = scene.nodes.len();
        let name = name_or(&source.name, "node", index);
        if let Some(camera) = source.camera {
            let camera =
                read_camera(root, camera.value(), &source.name, &to_world, &mut camera_names, report);
            if let Some(camera) = camera.map_err(of)? {
                if !root.animations.is_empty() {
                    let mut chain: Vec<_> =
                        std::iter::successors(Some(index), |&node| parents[node]).collect();
                    chain.reverse();
                    in_chains += chain.len();
                    if in_chains > CAMERA_CHAINS_MAX {
                        let most = CAMERA_CHAINS_MAX;
                        return Err(of(format!(
                            "is a camera too many in so deep a tree ({most} nodes in all)"
                        )));
                    }
                    let (name, fov_degrees) = (camera.name.clone(), camera.pose.fov_degrees);
                    placed.push(Placed { name, fov_degrees, chain });
                }
                scene.cameras.push(camera);
            }
        }
        if let Some(light) = source.extensions.as_ref().and_then(|all| all.khr_lights_punctual.as_ref()) {
            read_light(root, light.light.value(), &to_world, scene, report).map_err(of)?;
        }
        if source.skin.is_some() {
            report.warn("skins are not applied: skinned meshes are shown in their rest pose");
        }
        scene.nodes.push(Node { name, transform, mesh, children: Vec::new() });
        match parent {
            Some(parent) => scene.nodes[parent].children.push(place),
            None => scene.roots.push(place),
        }
        let children = source.children.iter().flatten().rev();
        stack.extend(children.map(|child| (child.value(), Some(place), to_world, depth + 1)));
    }
    Ok(placed)
}

/// The parent of every node; several parents and cycles are errors.
fn parents(root: &Root) -> Result<Vec<Option<usize>>, String> {
    let mut parents = vec![None; root.nodes.len()];
    for (index, node) in root.nodes.iter().enumerate() {
        for child in node.children.iter().flatten() {
            let child = child.value();
            let slot = parents.get_mut(child).ok_or_else(|| {
                format!("nodes[{index}] names the child {child}, but there are {} nodes", root.nodes.len())
            })?;
            if let Some(other) = slot.replace(index) {
                return Err(format!("nodes[{child}] has two parents, nodes[{other}] and nodes[{index}]"));
            }
        }
    }
    // With at most one parent each, a node that no parentless node leads to lies on a cycle or hangs below one.
    let mut seen = vec![false; root.nodes.len()];
    let mut stack: Vec<usize> = (0..parents.len()).filter(|&index| parents[index].is_none()).collect();
    while let Some(index) = stack.pop() {
        seen[index] = true;
        stack.extend(root.nodes[index].children.iter().flatten().map(|child| child.value()));
    }
    match seen.iter().position(|seen| !seen) {
        Some(index) => {
            Err(format!("nodes[{index}] is its own ancestor or below such a node: the node tree has a cycle"))
        }
        None => Ok(parents),
    }
}

/// The roots of the scene to show: the default one, else the first, else every node without a parent.
fn roots(root: &Root, parents: &[Option<usize>], report: &mut Report) -> Result<Vec<usize>, String> {
    if root.scenes.is_empty() && root.scene.is_none() {
        return Ok((0..parents.len()).filter(|&index| parents[index].is_none()).collect());
    }
    let shown_index = root.scene.map_or(0, |scene| scene.value());
    let scene = get(&root.scenes, shown_index, "scenes")?;
    if root.scenes.len() > 1 {
        report.warn(format!("only scenes[{shown_index}] of {} is shown", root.scenes.len()));
    }
    let mut is_root = vec![false; parents.len()];
    for node in &scene.nodes {
        let index = node.value();
        match parents.get(index) {
            None => {
                return Err(format!(
                    "scenes[{shown_index}] names node {index}, but there are {}",
                    parents.len()
                ));
            }
            Some(Some(parent)) => {
                return Err(format!(
                    "scenes[{shown_index}] names nodes[{index}], which is a child of nodes[{parent}]"
                ));
            }
            Some(None) if is_root[index] => {
                return Err(format!("scenes[{shown_index}] names nodes[{index}] twice"));
            }
            Some(None) => is_root[index] = true,
        }
    }
    Ok(scene.nodes.iter().map(|node| node.value()).collect())
}

/// A node's transform at rest.
pub(super) fn transform(node: &json::Node) -> Result<DMat4, String> {
    let transform = match node.matrix {
        Some(matrix) => {
            let matrix = DMat4::from_cols_array(&matrix.map(f64::from));
            if matrix.is_finite() && matrix.row(3) != DVec4::W {
                return Err("has a matrix whose last row is not 0 0 0 1".to_owned());
            }
            matrix
        }
        None => {
            let (scale, rotation, translation) = parts(node)?;
            DMat4::from_scale_rotation_translation(scale, rotation, translation)
        }
    };
    if transform.is_finite() { Ok(transform) } else { Err("has a transform that is not finite".to_owned()) }
}

/// Scale, rotation and translation of a node without a matrix.
pub(super) fn parts(node: &json::Node) -> Result<(DVec3, DQuat, DVec3), String> {
    let vector = |value: Option<[f32; 3]>, default| value.map_or(default, |v| DVec3::from(v.map(f64::from)));
    let [x, y, z, w] = node.rotation.map_or([0.0, 0.0, 0.0, 1.0], |rotation| rotation.0).map(f64::from);
    let rotation = DQuat::from_xyzw(x, y, z, w);
    // The file's four numbers were rounded; in f64 they are not a unit quaternion any more.
    let length_squared = rotation.length_squared();
    if length_squared == 0.0 || !length_squared.is_finite() {
        return Err("has a rotation without direction".to_owned());
    }
    Ok((vector(node.scale, DVec3::ONE), rotation.normalize(), vector(node.translation, DVec3::ZERO)))
}

fn read_light(
    root: &Root,
    index: usize,
    to_world: &DMat4,
    scene: &mut Scene,
    report: &mut Report,
) -> Result<(), String> {
    let lights: &[khr_lights_punctual::Light] = root.as_ref();
    let source = get(lights, index, "lights")?;
    let of = |what: String| format!("has lights[{index}], which {what}");
    let name = name_or(&source.name, "light", index);
    let intensity = source.color.map(|channel| channel * source.intensity);
    if intensity.iter().any(|&channel| !channel.is_finite() || channel < 0.0) {
        return Err(of("has a negative or infinite intensity".to_owned()));
    }
    let kind = match checked(&source.type_).map_err(of)? {
        khr_lights_punctual::Type::Point => LightKind::Point,
        khr_lights_punctual::Type::Directional => LightKind::Directional,
        khr_lights_punctual::Type::Spot => {
            let spot = source.spot.as_ref().ok_or_else(|| of("is a spot without a cone".to_owned()))?;
            let (inner, outer) = (spot.inner_cone_angle, spot.outer_cone_angle);
            if !(0.0 <= inner && inner < outer && outer <= std::f32::consts::FRAC_PI_2) {
                return Err(of(format!(
                    "has cone angles {inner} and {outer}; 0 <= inner < outer <= pi/2 must hold"
                )));
            }
            LightKind::Spot { inner, outer }
        }
    };
    // Lights shine along -z; scale does not change how strong they are or how far they reach.
    let Some(direction) = to_world.transform_vector3(DVec3::NEG_Z).try_normalize() else {
        report.warn(format!("the light \"{}\" has no direction and is left out", shown(&name)));
        return Ok(());
    };
    let range = match source.range {
        Some(range) if range > 0.0 => range,
        Some(_) => {
            report.warn(format!(
                "the light \"{}\" has a range that is not positive; it is unlimited here",
                shown(&name)
            ));
            f32::INFINITY
        }
        None => f32::INFINITY,
    };
    let position = to_world.transform_point3(DVec3::ZERO);
    if position.abs().max_element() > COORDINATE_MAX {
        return Err(of(format!("lies beyond the coordinate {COORDINATE_MAX:e}; scale the scene down")));
    }
    scene.lights.push(Light { name, kind, position, direction, intensity, range });
    Ok(())
}

/// The camera, unless it is left out.
fn read_camera(
    root: &Root,
    index: usize,
    node_name: &Option<String>,
    to_world: &DMat4,
    names: &mut Names,
    report: &mut Report,
) -> Result<Option<Camera>, String> {
    let source = get(&root.cameras, index, "cameras")?;
    let given = node_name.as_ref().filter(|name| !name.is_empty()).or(source.name.as_ref());
    let name = name_or(&given.cloned(), "camera", index);
    let Some(perspective) = &source.perspective else {
        report.warn(format!(
            "the camera \"{}\" is orthographic, which is not supported; it is left out",
            shown(&name)
        ));
        return Ok(None);
    };
    let yfov = f64::from(perspective.yfov);
    let has_view = yfov > 0.0 && yfov < std::f64::consts::PI;
    let Some(pose) = pose_of(to_world, yfov.to_degrees()).filter(|_| has_view) else {
        report.warn(format!(
            "the camera \"{}\" has no direction or no field of view; it is left out",
            shown(&name)
        ));
        return Ok(None);
    };
    let name = names.distinct(name);
    Ok(Some(Camera { name, pose }))
}

/// Names of cameras: `--camera` takes one, so that they must differ.
#[derive(Default)]
struct Names {
    taken: HashSet<String>,
    /// How many there are.
    count: usize,
    /// The number to try next behind a name that was taken before: without it many cameras of one name would take quadratic time.
    next: HashMap<String, usize>,
}

impl Names {
    /// `name`, with a number behind it if it is taken: from its place among the cameras on.
    fn distinct(&mut self, name: String) -> String {
        self.count += 1;
        let first = self.count;
        if self.taken.insert(name.clone()) {
            return name;
        }
        let next = self.next.entry(name.clone()).or_insert(first);
        loop {
            let numbered = format!("{name} {next}");
            *next += 1;
            if self.taken.insert(numbered.clone()) {
                return numbered;
            }
        }
    }
}
