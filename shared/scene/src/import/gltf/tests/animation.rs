//! Cameras that animations move.

use super::*;

/// A camera `eye` (node 2) that stands 2 above an arm (node 1), with samplers of times 0 and 2.
fn draft() -> Draft {
    let mut draft = Draft::triangle();
    draft.json["nodes"] = json!([
        {"mesh": 0},
        {"children": [2], "translation": [0, 0, 5]},
        {"camera": 0, "name": "eye", "translation": [0, 2, 0]},
    ]);
    draft.json["scenes"] = json!([{"nodes": [0, 1]}]);
    draft.json["cameras"] = json!([{"type": "perspective", "perspective": {"yfov": 1.0, "znear": 0.1}}]);
    draft
}

fn channel(sampler: usize, node: usize, path: &str) -> Value {
    json!({"sampler": sampler, "target": {"node": node, "path": path}})
}

/// Moves node 1 along x from 0 to 4, and turns node 2 by a quarter to the left.
fn moved() -> Draft {
    let mut draft = draft();
    let times = draft.accessor("SCALAR", F32, 2, false, &[0.0_f32, 2.0].map(f32::to_le_bytes).concat());
    let places = draft.floats("VEC3", &[0.0, 0.0, 5.0, 4.0, 0.0, 5.0]);
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let turns = draft.floats("VEC4", &[0.0, 0.0, 0.0, 1.0, 0.0, half, 0.0, half]);
    draft.json["animations"] = json!([{
        "name": "walk",
        "samplers": [{"input": times, "output": places}, {"input": times, "output": turns}],
        "channels": [channel(0, 1, "translation"), channel(1, 2, "rotation")],
    }]);
    draft
}

#[test]
fn a_camera_follows_its_animation() {
    let scene = moved().import().unwrap();
    let [track] = &scene.camera_tracks[..] else { panic!("one camera moves") };
    assert_eq!((track.camera.as_str(), track.animation.as_str(), track.duration()), ("eye", "walk", 2.0));
    assert_eq!(scene.warnings, Vec::<String>::new());
    let pose = |seconds| track.pose_at(seconds).unwrap();
    // At rest as the scene shows it.
    let rest = scene.cameras[0].pose;
    assert!((pose(0.0).eye - rest.eye).length() < 1e-6 && (pose(0.0).target - rest.target).length() < 1e-6);
    assert_eq!(pose(0.0).fov_degrees, rest.fov_degrees);
    let middle = pose(1.0);
    assert!((middle.eye - DVec3::new(2.0, 2.0, 5.0)).length() < 1e-6);
    let eighth = DVec3::new(-1.0, 0.0, -1.0).normalize();
    assert!((middle.target - middle.eye - eighth).length() < 1e-6, "{middle:?}");
    for late in [2.0, 100.0] {
        assert!((pose(late).target - pose(late).eye - DVec3::NEG_X).length() < 1e-6);
    }
}

#[test]
fn steps_and_splines_are_read() {
    let mut draft = moved();
    draft.json["animations"][0]["samplers"][0]["interpolation"] = json!("STEP");
    let spline: Vec<f32> =
        [[0.0; 4], [0.0, 0.0, 0.0, 1.0], [0.0; 4], [0.0; 4], [0.0, 1.0, 0.0, 0.0], [0.0; 4]].concat();
    let turns = draft.floats("VEC4", &spline);
    draft.json["animations"][0]["samplers"][1] = json!({"input": draft.json["animations"][0]["samplers"][0]["input"], "output": turns, "interpolation": "CUBICSPLINE"});
    let scene = draft.import().unwrap();
    let pose = scene.camera_tracks[0].pose_at(1.0).unwrap();
    assert!((pose.eye - DVec3::new(0.0, 2.0, 5.0)).length() < 1e-6, "the step holds");
    // Half way of half a turn, as the spline is symmetric.
    assert!((pose.target - pose.eye - DVec3::NEG_X).length() < 1e-6);
}

#[test]
fn what_moves_no_camera_is_left_out_and_said() {
    let mut draft = moved();
    draft.json["animations"][0]["channels"] = json!([channel(0, 0, "translation")]);
    let scene = draft.import().unwrap();
    assert_eq!(scene.camera_tracks.len(), 0);
    assert!(scene.warnings[0].contains("animations are played for cameras alone"), "{:?}", scene.warnings);
    // Of several animations the first is played.
    let mut draft = moved();
    let mut other = draft.json["animations"][0].clone();
    other["name"] = json!("run");
    draft.json["animations"].as_array_mut().unwrap().push(other);
    let scene = draft.import().unwrap();
    assert_eq!(scene.camera_tracks[0].animation, "walk");
    assert!(scene.warnings[0].contains("several animations move the camera \"eye\""));
}

#[test]
fn broken_animations_are_refused() {
    type Change = fn(&mut Draft);
    let cases: [(Change, &str); 12] = [
        (|d| d.json["animations"][0]["channels"][0]["target"]["node"] = json!(9), "needs nodes[9]"),
        (
            |d| d.json["animations"][0]["channels"][0]["target"]["path"] = json!("fov"),
            "glTF 2.0 does not know",
        ),
        (|d| d.json["animations"][0]["channels"][0]["sampler"] = json!(7), "needs samplers[7]"),
        (|d| d.json["animations"][0]["samplers"][0]["input"] = json!(99), "needs accessors[99]"),
        (|d| d.json["animations"][0]["samplers"][0]["output"] = json!(99), "needs accessors[99]"),
        (
            |d| d.json["animations"][0]["samplers"][0]["interpolation"] = json!("WARP"),
            "glTF 2.0 does not know",
        ),
        (|d| d.json["animations"][0]["samplers"][0]["interpolation"] = json!("CUBICSPLINE"), "3 each"),
        (|d| d.json["animations"][0]["channels"][0]["sampler"] = json!(1), "4 numbers where 3"),
        (
            |d| d.json["animations"][0]["channels"][0]["target"]["path"] = json!("rotation"),
            "3 numbers where 4",
        ),
        (
            |d| {
                let again = d.json["animations"][0]["channels"][0].clone();
                d.json["animations"][0]["channels"].as_array_mut().unwrap().push(again);
            },
            "that another channel does",
        ),
        (
            |d| {
                let times = [2.0_f32, 2.0].map(f32::to_le_bytes).concat();
                let times = d.accessor("SCALAR", F32, 2, false, &times);
                d.json["animations"][0]["samplers"][0]["input"] = json!(times);
            },
            "do not ascend",
        ),
        (
            |d| {
                d.json["nodes"][1] = json!({"children": [2], "matrix": [1,0,0,0, 0,1,0,0, 0,0,1,0, 0,0,5,1]});
            },
            "which has a matrix",
        ),
    ];
    for (change, why) in cases {
        let mut draft = moved();
        change(&mut draft);
        let error = draft.error();
        assert!(error.contains(why), "{error}\nwanted: {why}");
    }
}
