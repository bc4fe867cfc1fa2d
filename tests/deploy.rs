//! The container files keep their promises, as far as that shows without a container engine.

use crate::support::{Tessera, root};
use std::fs;

fn file(name: &str) -> String {
    fs::read_to_string(root().join("deploy").join(name)).expect("a file of deploy/")
}

/// Instructions of the Containerfile's last stage: a word and what follows it.
fn last_stage(text: &str) -> Vec<(&str, &str)> {
    let lines = text.lines().filter(|line| line.starts_with(|c: char| c.is_ascii_uppercase()));
    let all: Vec<_> = lines.filter_map(|line| line.split_once(' ')).collect();
    let from = all.iter().rposition(|(word, _)| *word == "FROM").expect("a stage");
    all[from..].to_vec()
}

#[test]
fn the_image_runs_as_nobody_special_and_holds_the_program_alone() {
    let text = file("Containerfile");
    let stage = last_stage(&text);
    let find =
        |word: &str| stage.iter().filter(|(w, _)| *w == word).map(|(_, rest)| *rest).collect::<Vec<_>>();
    let user: u32 = find("USER")[0].split(':').next().and_then(|id| id.parse().ok()).expect("a numeric user");
    assert_ne!(user, 0);
    assert_eq!(find("COPY"), ["--from=build /out/tessera /usr/local/bin/tessera"]);
    assert_eq!(find("ENTRYPOINT"), [r#"["/usr/local/bin/tessera"]"#]);
    // What the first stage copies is what the ignore file lets through.
    let copied: Vec<_> = text.lines().filter_map(|line| line.strip_prefix("COPY ")).collect();
    let sources = copied.iter().filter(|line| !line.starts_with("--from"));
    let mut sources: Vec<_> =
        sources.flat_map(|line| line.split(' ').filter(|word| !word.starts_with("./"))).collect();
    let ignored = file("Containerfile.dockerignore");
    let mut let_in: Vec<_> = ignored.lines().filter_map(|line| line.strip_prefix('!')).collect();
    sources.sort_unstable();
    let_in.sort_unstable();
    assert_eq!(sources, let_in);
    assert!(ignored.lines().any(|line| line == "*"), "everything else stays out");
    assert!(sources.iter().all(|name| root().join(name).exists()), "{sources:?}");
}

#[test]
fn every_command_in_compose_is_one_of_the_program() {
    let text = file("compose.yaml");
    // Lists are written as JSON on one line.
    let lists = |key: &str| -> Vec<Vec<String>> {
        let lines = text.lines().filter_map(|line| line.trim_start().strip_prefix(key));
        lines.map(|list| serde_json::from_str(list).unwrap_or_else(|e| panic!("{list}: {e}"))).collect()
    };
    let mut commands = lists("command: ");
    // The client's command stands in its entrypoint.
    let client = lists("entrypoint: ").into_iter().find(|list| list.len() > 1 && list[1] == "render");
    commands.push(client.expect("a client")[1..].to_vec());
    let mut seen = Vec::new();
    for command in commands.iter().filter(|command| !command[0].starts_with('-')) {
        let help = Tessera::new([command[0].as_str(), "--help"]).run().ok();
        for flag in command[1..].iter().filter(|word| word.starts_with('-')) {
            assert!(
                help.contains(&format!("{flag} ")) || help.contains(&format!("{flag},")),
                "{command:?}: {flag}"
            );
        }
        seen.push(command[0].as_str());
    }
    assert_eq!(seen, ["master", "worker", "render"]);
}

#[test]
fn every_service_gives_up_what_it_does_not_need() {
    let text = file("compose.yaml");
    for promise in [
        "read_only: true",
        "cap_drop: [\"ALL\"]",
        "no-new-privileges:true",
        "stop_grace_period: ",
        "restart: unless-stopped",
        "condition: service_healthy",
    ] {
        assert!(text.contains(promise), "{promise}");
    }
    let services =
        text.split("\nservices:\n").nth(1).expect("services").split("\nvolumes:\n").next().expect("a part");
    let names = services
        .lines()
        .filter(|line| line.starts_with("  ") && !line.starts_with("   ") && line.ends_with(':'));
    let count = names.count();
    assert_eq!(count, 3, "master, worker, render");
    assert_eq!(services.matches("<<: *tessera\n").count(), count, "each has the common part");
    assert_eq!(services.matches("mem_limit: ").count(), count, "each has a limit of memory");
}
