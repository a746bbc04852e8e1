//! The floors of the code hold: arrows go down only, and a few rules of the house.

use std::path::{Path, PathBuf};

/// The floors from the lowest; those of one line may not use each other.
const FLOORS: [&[&str]; 11] = [
    &["base"],
    &["store"],
    &["mesh"],
    &["graph"],
    &["distance"],
    &["spectral"],
    &["landmarks"],
    &["cluster"],
    &["apps"],
    &["pipeline"],
    &["cli", "main"],
];

fn sources(folder: &Path, all: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            sources(&path, all);
        } else if path.extension().is_some_and(|end| end == "rs") {
            all.push(path);
        }
    }
}

/// Every source file: its path below `src`, its text, and its text without comments.
fn files() -> Vec<(String, String, String)> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    sources(&root, &mut paths);
    paths.sort();
    assert!(paths.len() > 40);
    let read = |path: PathBuf| {
        let name = path.strip_prefix(&root).unwrap().to_str().unwrap().replace('\\', "/");
        let text = std::fs::read_to_string(path).unwrap();
        let code: String = text.lines().map(|line| line.split("//").next().unwrap_or("").to_owned() + "\n").collect();
        (name, text, code)
    };
    paths.into_iter().map(read).collect()
}

/// The floor of a file or of a module's name.
fn floor(name: &str) -> Option<usize> {
    let module = name.split('/').next()?.trim_end_matches(".rs");
    FLOORS.iter().position(|floor| floor.contains(&module))
}

/// The modules of this crate that `code` names after `prefix`, as `prefix::store` or `prefix::{base, store}`.
fn named(code: &str, prefix: &str) -> Vec<String> {
    let mut found = Vec::new();
    for (at, _) in code.match_indices(prefix) {
        let whole = !code[..at].ends_with(|c: char| c.is_alphanumeric() || c == '_' || c == ':');
        let rest = &code[at + prefix.len()..];
        let Some(rest) = rest.strip_prefix("::").filter(|_| whole) else { continue };
        let word = |text: &str| text.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect::<String>();
        if let Some(list) = rest.strip_prefix('{') {
            // The first word of each item at the list's own depth.
            let (mut depth, mut start) = (0, true);
            for (k, c) in list.char_indices() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => start = true,
                    c if start && !c.is_whitespace() => {
                        found.push(word(&list[k..]));
                        start = false;
                    }
                    _ => {}
                }
            }
        } else {
            found.push(word(rest));
        }
    }
    found
}

#[test]
fn imports_go_down_only() {
    let mut wrong = String::new();
    let mut seen = 0;
    for (name, _, code) in files().iter().filter(|(name, ..)| name != "lib.rs") {
        let mine = floor(name).unwrap_or_else(|| panic!("src/{name} belongs to no floor; name its floor here"));
        let module = name.split('/').next().unwrap().trim_end_matches(".rs");
        for used in named(code, "crate").into_iter().chain(named(code, "nystrom_stream")) {
            // The program's own modules and the library's macros aside.
            let Some(theirs) = floor(&used) else { continue };
            seen += 1;
            if theirs > mine || (theirs == mine && used != module && module != "main") {
                wrong += &format!("src/{name} uses {used}\n");
            }
        }
    }
    assert!(wrong.is_empty(), "arrows go down only:\n{wrong}");
    assert!(seen > 100, "{seen}");
}

#[test]
fn only_the_command_line_knows_its_crates() {
    for (name, _, code) in files() {
        let inside = name.starts_with("cli/") || name == "main.rs";
        for banned in ["clap", "clap_complete", "clap_mangen", "indicatif", "ctrlc"] {
            let used = !named(&code, banned).is_empty() || code.contains(&format!("use {banned};"));
            assert!(inside || !used, "src/{name} uses {banned}");
        }
        let prints = ["println!", "eprintln!", "print!(", "dbg!"].iter().any(|word| code.contains(word));
        assert!(!prints, "src/{name} prints; tell progress or write to a stream whose errors are handled");
    }
}

#[test]
fn unsafe_code_lives_in_one_file() {
    for (name, _, code) in files() {
        let words = code.split(|c: char| !(c.is_alphanumeric() || c == '_'));
        let used = words.filter(|word| *word == "unsafe").count();
        assert!(used == 0 || name == "store/mapped.rs", "src/{name} has unsafe code");
    }
}

#[test]
fn files_are_short_and_say_what_they_are() {
    for (name, text, code) in files() {
        let lines = text.lines().count();
        assert!(lines <= 900, "src/{name} has {lines} lines, more than 900: split it");
        assert!(text.starts_with("//! "), "src/{name} does not begin with what it is");
        for word in ["todo!", "unimplemented!", "TODO", "FIXME", "XXX"] {
            assert!(!text.contains(word) || name == "lib.rs", "src/{name} has {word}");
        }
        let _ = code;
    }
}
