//! What the pages point to is there: links, headings, pictures, and paths of the source, in pages and in comments.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Files below `folder` that end in `ending`, paths from the root.
fn files(folder: &str, ending: &str, all: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(root().join(folder)).unwrap() {
        let path = entry.unwrap().path();
        let name = path.strip_prefix(root()).unwrap().to_path_buf();
        let word = name.file_name().unwrap().to_str().unwrap();
        if path.is_dir() && !word.starts_with('.') && word != "target" {
            files(name.to_str().unwrap(), ending, all);
        } else if word.ends_with(ending) {
            all.push(name);
        }
    }
    all.sort();
}

fn pages() -> Vec<PathBuf> {
    let mut pages = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md", "CHANGELOG.md"].map(PathBuf::from).to_vec();
    ["docs", "python", "benches"].into_iter().for_each(|folder| files(folder, ".md", &mut pages));
    assert!(pages.len() > 8, "{pages:?}");
    pages
}

fn text(page: &Path) -> String {
    std::fs::read_to_string(root().join(page)).unwrap()
}

/// The prose of a page: without fenced blocks.
fn prose(page: &Path) -> String {
    let (mut inside, mut out) = (false, String::new());
    for line in text(page).lines() {
        if line.starts_with("```") {
            inside = !inside;
        } else if !inside {
            out += &format!("{line}\n");
        }
    }
    out
}

/// What GitHub makes of a heading for links to it.
fn anchor(heading: &str) -> String {
    let kept = |c: &char| c.is_alphanumeric() || [' ', '-', '_'].contains(c);
    heading.trim().to_lowercase().chars().filter(kept).map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn anchors(page: &Path) -> BTreeSet<String> {
    let prose = prose(page);
    prose.lines().filter(|line| line.starts_with('#')).map(|line| anchor(line.trim_start_matches('#'))).collect()
}

/// Targets of links and pictures in Markdown.
fn targets(prose: &str) -> Vec<String> {
    let ends = prose.match_indices("](").map(|(at, _)| &prose[at + 2..]);
    ends.filter_map(|rest| Some(rest[..rest.find(')')?].trim().to_string())).collect()
}

#[test]
fn links_lead_somewhere() {
    let (mut wrong, mut seen) = (String::new(), 0);
    for page in pages() {
        for target in targets(&prose(&page)) {
            if target.starts_with("http") {
                continue;
            }
            seen += 1;
            let (path, heading) = target.split_once('#').map_or((&target[..], None), |(a, b)| (a, Some(b)));
            let folder = page.parent().unwrap();
            let to = if path.is_empty() { page.clone() } else { folder.join(path) };
            let there = root().join(&to).exists();
            let heading_there = || heading.is_none_or(|heading| anchors(&to).contains(heading));
            if !there || !heading_there() {
                wrong += &format!("{}: {target}\n", page.display());
            }
        }
    }
    assert!(wrong.is_empty(), "dead links:\n{wrong}");
    assert!(seen > 30, "{seen}");
}

/// Paths of the project among the words of `text`.
fn paths(text: &str) -> impl Iterator<Item = &str> {
    const FOLDERS: [&str; 7] = ["src/", "docs/", "tools/", "tests/", "examples/", "benches/", "python/"];
    let part = |c: char| c.is_alphanumeric() || "/._-".contains(c);
    let words = text.split(move |c: char| !part(c)).map(|word| word.trim_end_matches(['.', '-', '/']));
    words.filter(|word| FOLDERS.iter().any(|folder| word.starts_with(folder)))
}

#[test]
fn paths_in_pages_and_comments_exist() {
    let (mut wrong, mut seen) = (String::new(), 0);
    let mut sources = Vec::new();
    ["src", "benches", "examples", "tests"].into_iter().for_each(|folder| files(folder, ".rs", &mut sources));
    let comments = |path: &PathBuf| {
        let of = |line: &str| line.split_once("//").map(|(_, comment)| comment.to_string());
        text(path).lines().filter_map(of).collect::<Vec<_>>().join("\n")
    };
    let all = pages().into_iter().map(|page| (prose(&page), page));
    for (text, file) in all.chain(sources.iter().map(|path| (comments(path), path.clone()))) {
        for path in paths(&text) {
            // Relative to the page, or to the root; a Rust path may name what a file holds.
            let beside = file.parent().unwrap().join(path);
            seen += 1;
            if ![Path::new(path), &beside].iter().any(|path| root().join(path).exists()) {
                wrong += &format!("{}: {path}\n", file.display());
            }
        }
    }
    assert!(wrong.is_empty(), "no such files:\n{wrong}");
    assert!(seen > 30, "{seen}");
}

#[test]
fn every_picture_is_shown_and_small() {
    let shown: BTreeSet<PathBuf> = pages()
        .iter()
        .flat_map(|page| targets(&prose(page)).into_iter().map(|target| page.parent().unwrap().join(target)))
        .map(|path| root().join(path))
        .filter_map(|path| path.canonicalize().ok())
        .collect();
    for entry in std::fs::read_dir(root().join("docs/pictures")).unwrap() {
        let path = entry.unwrap().path().canonicalize().unwrap();
        // A vector form beside the bitmap that is shown will do.
        let either = ["png", "svg"].map(|ending| path.with_extension(ending));
        assert!(either.iter().any(|path| shown.contains(path)), "{} is on no page", path.display());
        let bytes = path.metadata().unwrap().len();
        assert!(bytes < 300_000, "{} has {bytes} bytes", path.display());
    }
}

#[test]
fn links_lead_from_the_readme_to_every_page() {
    let mut reached = BTreeSet::from([root().join("README.md")]);
    let mut ahead: Vec<PathBuf> = reached.iter().cloned().collect();
    while let Some(page) = ahead.pop() {
        for target in targets(&prose(&page)) {
            let path = page.parent().unwrap().join(target.split('#').next().unwrap());
            let Ok(path) = path.canonicalize() else { continue };
            if path.extension().is_some_and(|end| end == "md") && reached.insert(path.clone()) {
                ahead.push(path);
            }
        }
    }
    for page in pages().iter().filter(|page| !page.starts_with("benches")) {
        let path = root().join(page).canonicalize().unwrap();
        assert!(reached.contains(&path), "no links lead from README.md to {}", page.display());
    }
}
