//! The layers of the code hold: imports go down only, no files import each other in a circle, and
//! a few rules of the house.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::path::{Path, PathBuf};

/// The layers from the lowest; those of one line may not use each other.
const LAYERS: [&[&str]; 12] = [
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
    &["api"],
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

/// The layer of a file or of a module's name.
fn layer(name: &str) -> Option<usize> {
    let module = name.split('/').next()?.trim_end_matches(".rs");
    LAYERS.iter().position(|layer| layer.contains(&module))
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
        let mine = layer(name).unwrap_or_else(|| panic!("src/{name} belongs to no layer; name its layer here"));
        let module = name.split('/').next().unwrap().trim_end_matches(".rs");
        for used in named(code, "crate").into_iter().chain(named(code, "nystrom_stream")) {
            // The program's own modules and the library's macros aside.
            let Some(theirs) = layer(&used) else { continue };
            seen += 1;
            if theirs > mine || (theirs == mine && used != module && module != "main") {
                wrong += &format!("src/{name} uses {used}\n");
            }
        }
    }
    assert!(wrong.is_empty(), "imports go down only:\n{wrong}");
    assert!(seen > 100, "{seen}");
}

#[test]
fn only_the_command_line_knows_its_crates() {
    for (name, _, code) in files() {
        let inside = name.starts_with("cli/") || name == "main.rs";
        for banned in ["clap", "clap_complete", "clap_mangen", "indicatif", "signal_hook", "glob", "cap", "mimalloc"] {
            let used = !named(&code, banned).is_empty() || code.contains(&format!("use {banned};"));
            assert!(inside || !used, "src/{name} uses {banned}");
        }
        let prints = ["println!", "eprintln!", "print!(", "dbg!"].iter().any(|word| code.contains(word));
        assert!(!prints, "src/{name} prints; tell progress or write to a stream whose errors are handled");
    }
}

/// Errors and notes of the library reach its users and Python's too, who have no flags: the command line puts them in.
#[test]
fn only_the_command_line_speaks_of_flags() {
    for (name, _, code) in files() {
        if name.starts_with("cli/") || name == "main.rs" {
            continue;
        }
        let flag = |line: &&str| {
            let starts = |(at, _): (usize, &str)| line[at + 2..].starts_with(|c: char| c.is_ascii_lowercase());
            let command = |name| line.contains(&format!("nystrom-stream {name} "));
            let commands = ["segment", "graph", "rows", "embed", "cluster", "export"];
            line.contains('"') && line.match_indices("--").any(starts) || commands.into_iter().any(command)
        };
        let said = code.lines().find(flag);
        assert_eq!(said, None, "src/{name} speaks of the command line");
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

/// Of the system's mathematical library, the last bits depend on the processor. Colours, pictures and plots may.
#[test]
fn results_do_not_depend_on_the_systems_mathematical_library() {
    let decide = [
        "apps/correspond/",
        "apps/evaluate/",
        "apps/measure/",
        "apps/sequence/",
        "apps/study/",
        "apps/transfer/",
        "base/",
        "cluster/",
        "distance/",
        "graph/",
        "landmarks/",
        "pipeline/",
        "spectral/",
    ];
    let calls = [".exp()", ".ln()", ".log2()", ".powf(", ".sin()", ".cos()", ".sin_cos()", ".atan2(", ".cbrt()"];
    for (name, _, code) in files() {
        let (code, _) = code.split_once("mod tests {").unwrap_or((&code, ""));
        let call =
            calls.iter().find(|call| decide.iter().any(|layer| name.starts_with(layer)) && code.contains(**call));
        assert!(call.is_none(), "src/{name} calls {}: take libm's or spectral::exp's", call.unwrap());
    }
}

#[test]
fn files_are_short_and_say_what_they_are() {
    for (name, text, _) in files() {
        let lines = text.lines().count();
        assert!(lines <= 600, "src/{name} has {lines} lines, more than 600: split it");
        // The first paragraph is a sentence that says more than the file's name.
        let header: Vec<&str> = text.lines().map_while(|line| line.strip_prefix("//! ")).collect();
        let (words, end) = (header.join(" ").split_whitespace().count(), header.last().unwrap_or(&""));
        assert!(words >= 4 && end.ends_with(['.', '?', ':']), "src/{name} does not begin with what it is: {header:?}");
        for word in ["todo!", "unimplemented!", "TODO", "FIXME", "XXX"] {
            assert!(!text.contains(word) || name == "lib.rs", "src/{name} has {word}");
        }
    }
}

#[test]
fn comments_are_as_narrow_as_code() {
    for (name, text, _) in files() {
        let long = |line: &str| line.trim_start().starts_with("//") && line.chars().count() > 120;
        let long = text.lines().position(long);
        assert_eq!(long.map(|k| k + 1), None, "src/{name} has a line of comment of more than 120 characters");
    }
}

/// The use trees of `use …;` in `code`, with whether they are public, and the code without them.
fn uses(code: &str) -> (Vec<(bool, String)>, String) {
    let (mut trees, mut rest) = (Vec::new(), String::new());
    let mut left = code;
    while let Some(at) = left.find("use ") {
        let before = left[..at].trim_end();
        let line = &left[..at].rsplit('\n').next().unwrap_or("").trim();
        let public = line.starts_with("pub");
        if (line.is_empty() || public) && (before.is_empty() || public || before.ends_with([';', '}', '{', ']'])) {
            let end = left[at..].find(';').map_or(left.len(), |end| at + end);
            trees.push((public, left[at + 4..end].split_whitespace().collect::<Vec<_>>().join(" ")));
            rest += &left[..at];
            left = &left[end..];
        } else {
            rest += &left[..at + 4];
            left = &left[at + 4..];
        }
    }
    (trees, rest + left)
}

/// The paths of a use tree, each with the name that it is known by.
fn paths(tree: &str, prefix: &[String], out: &mut Vec<(String, Vec<String>)>) {
    let tree = tree.trim();
    if let Some((head, list)) = tree.split_once('{').filter(|(head, _)| head.is_empty() || head.ends_with("::")) {
        let mut prefix = prefix.to_vec();
        prefix.extend(head.split("::").filter(|word| !word.is_empty()).map(str::to_owned));
        let (mut depth, mut start) = (0, 0);
        let list = &list[..list.rfind('}').unwrap_or(list.len())];
        for (k, c) in list.char_indices().chain([(list.len(), ',')]) {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => {
                    if !list[start..k].trim().is_empty() {
                        paths(&list[start..k], &prefix, out);
                    }
                    start = k + 1;
                }
                _ => {}
            }
        }
    } else {
        let (path, name) = tree.split_once(" as ").unwrap_or((tree, tree.rsplit("::").next().unwrap_or("")));
        let mut whole = prefix.to_vec();
        whole.extend(path.split("::").filter(|word| *word != "self" || prefix.is_empty()).map(|w| w.trim().to_owned()));
        let name = if name == "self" { whole.last().cloned().unwrap_or_default() } else { name.to_owned() };
        out.push((name, whole));
    }
}

/// A source file as the module that it is.
struct Module {
    file: String,
    /// What it names: whether in a public `use`, the name, the path.
    names: Vec<(bool, String, Vec<String>)>,
}

/// The modules by path, `["graph", "order"]` for `graph/order/mod.rs`.
fn modules() -> BTreeMap<Vec<String>, Module> {
    let mut all = BTreeMap::new();
    for (file, _, code) in files() {
        let mut path: Vec<String> = file.trim_end_matches(".rs").split('/').map(str::to_owned).collect();
        if path.last().is_some_and(|last| last == "mod") || path == ["lib"] {
            path.pop();
        }
        // Tests may look where they like.
        let code = code.split("#[cfg(test)]").next().unwrap_or("");
        // What an inline module takes from the file around it is no import.
        let code: String =
            code.lines().filter(|line| *line != "    use super::*;").map(|line| line.to_owned() + "\n").collect();
        let (trees, rest) = uses(&code);
        let mut names = Vec::new();
        for (public, tree) in trees {
            let mut found = Vec::new();
            paths(&tree, &[], &mut found);
            names.extend(found.into_iter().map(|(name, path)| (public, name, path)));
        }
        for word in rest.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':')) {
            // A folder's `mod.rs` may hand work to its children by their names.
            if word.starts_with("crate::") || word.starts_with("super::") {
                let path: Vec<String> = word.split("::").map(str::to_owned).collect();
                names.push((false, String::new(), path));
            }
        }
        all.insert(path, Module { file, names });
    }
    all
}

/// The module that the item of `path`, as the module `from` names it, stands in; through public `use`s.
fn home(all: &BTreeMap<Vec<String>, Module>, from: &[String], path: &[String], depth: usize) -> Option<Vec<String>> {
    let (mut at, mut rest) = match path.first()?.as_str() {
        "crate" | "nystrom_stream" => (Vec::new(), &path[1..]),
        "self" => (from.to_vec(), &path[1..]),
        "super" => (from[..from.len().checked_sub(1)?].to_vec(), &path[1..]),
        first => {
            let child = [from, &[first.to_owned()]].concat();
            (all.contains_key(&child).then_some(child)?, &path[1..])
        }
    };
    while let Some(next) = rest.first() {
        if next == "super" {
            at.pop()?;
        } else {
            let child = [&at[..], std::slice::from_ref(next)].concat();
            if !all.contains_key(&child) {
                break;
            }
            at = child;
        }
        rest = &rest[1..];
    }
    let exported = rest.first().filter(|_| depth < 8).and_then(|item| {
        let mut public = all[&at].names.iter().filter(|(public, name, _)| *public && name == item);
        public.find_map(|(.., path)| home(all, &at, path, depth + 1))
    });
    Some(exported.unwrap_or(at))
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let all = modules();
    let mut graph: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
    for (path, module) in &all {
        for (public, _, used) in &module.names {
            let Some(target) = home(&all, path, used, 0) else { continue };
            // A module that shows what its children have does not depend on them.
            let shows = *public && target.starts_with(path);
            if target != *path && !shows {
                graph.entry(&module.file).or_default().insert(&all[&target].file);
            }
        }
    }
    assert!(graph.values().map(BTreeSet::len).sum::<usize>() > 500, "{graph:?}");
    let mut circles: BTreeMap<BTreeSet<&str>, String> = BTreeMap::new();
    for &start in graph.keys() {
        // The shortest way back to the file.
        let mut before: BTreeMap<&str, &str> = BTreeMap::new();
        let mut queue = VecDeque::from([start]);
        while let Some(file) = queue.pop_front() {
            for &next in graph.get(file).into_iter().flatten() {
                if !before.contains_key(next) {
                    before.insert(next, file);
                    queue.push_back(next);
                }
            }
        }
        let mut circle = vec![start];
        while let Some(&file) = before.get(circle[circle.len() - 1]) {
            circle.push(file);
            if file == start {
                circle.reverse();
                circles.insert(circle.iter().copied().collect(), circle.join(" → "));
                break;
            }
        }
    }
    let wrong: Vec<&String> = circles.values().collect();
    assert!(wrong.is_empty(), "files that import each other in a circle:\n{wrong:#?}");
}
