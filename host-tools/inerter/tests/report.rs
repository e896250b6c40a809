//! Pages and figures: what `report`, `plot` and `reproduce-paper` write, that it is valid and loads nothing.

mod common;

use std::{collections::BTreeSet, fs, path::Path};

use common::{done, fails, last};
use scraper::{Html, Selector};

const SECTIONS: [&str; 11] = [
    "results",
    "notes",
    "force",
    "residual",
    "loop",
    "parameters",
    "backlash",
    "bode",
    "conditions",
    "settings",
    "versions",
];

/// A page without a mistake, without nonsense, and without anything to load.
fn checked(path: &Path) -> Html {
    let page = fs::read_to_string(path).unwrap();
    let parsed = Html::parse_document(&page);
    assert_eq!(parsed.errors, Vec::<String>::new());
    for nonsense in ["NaN", "inf ", "Infinity", "undefined"] {
        assert!(!page.contains(nonsense), "{nonsense}");
    }
    let outside = page.replace("http://www.w3.org/2000/svg", "");
    for loading in ["http:", "https:", "<script", "<link", "@import", "url(", "src="] {
        assert!(!outside.contains(loading), "{loading}");
    }
    assert!(page.len() < 1_000_000, "{} bytes", page.len());
    parsed
}

fn count(page: &Html, selector: &str) -> usize {
    page.select(&Selector::parse(selector).unwrap()).count()
}

fn sections(page: &Html) -> BTreeSet<String> {
    page.select(&Selector::parse("section[id]").unwrap()).filter_map(|one| one.attr("id").map(str::to_string)).collect()
}

#[test]
fn a_report_has_every_section_and_figure_and_is_not_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let simulate = ["simulate", "-o", "a&b.mcap", "--preset", "worn", "--duration", "12", "--set", "terminal_sensor=1"];
    done(folder, &simulate);
    let line = last(&done(folder, &["report", "a&b.mcap", "-o", "page.html", "--png", "png", "--json"]));
    assert_eq!(line["kind"], "report");
    let names = ["force", "residual", "loop", "parameters", "backlash", "bode"];
    assert_eq!(line["figures"], serde_json::json!(names));
    for name in names {
        let bytes = fs::read(folder.join("png").join(format!("{name}.png"))).unwrap();
        assert!(bytes.starts_with(b"\x89PNG") && bytes.len() > 20_000, "{name}: {} bytes", bytes.len());
    }
    let page = checked(&folder.join("page.html"));
    assert!(SECTIONS.iter().all(|section| sections(&page).contains(*section)), "{:?}", sections(&page));
    assert_eq!((count(&page, "figure > svg"), count(&page, "figcaption"), count(&page, ".absent")), (6, 6, 0));
    assert_eq!(count(&page, "svg > title"), 6, "named for those who cannot see them");
    // Four parameters, backlash, stiffness and damping.
    assert_eq!(count(&page, "#results tbody tr"), 7);
    let before = fs::read(folder.join("page.html")).unwrap();
    assert!(fails(folder, &["report", "a&b.mcap", "-o", "page.html"], 8).contains("inerter::output::exists"));
    done(folder, &["report", "a&b.mcap", "-o", "page.html", "--force"]);
    assert_eq!(before, fs::read(folder.join("page.html")).unwrap(), "the same file, the same page");
}

#[test]
fn what_a_run_cannot_show_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (motion, duration, absent) in [("hold", "5", "bode"), ("slow", "20", "backlash"), ("random", "0.05", "force")] {
        let settings = ["--set", "stiffness_n_per_m=0"];
        let arguments = ["simulate", "-o", "run.csv", "--force", "--excite", motion, "--duration", duration];
        done(folder, &[&arguments[..], &settings].concat());
        let settings = ["--settings", "run.settings.toml"];
        done(folder, &[&["report", "run.csv", "-o", "page.html", "--force"][..], &settings].concat());
        let page = checked(&folder.join("page.html"));
        assert!(SECTIONS.iter().all(|section| sections(&page).contains(*section)), "{motion}");
        assert_eq!(count(&page, &format!("#{absent} .absent")), 1, "{motion}");
        let words =
            fails(folder, &[&["plot", "run.csv", "-o", "x.svg", "--figure", absent][..], &settings].concat(), 9);
        assert!(words.contains("inerter::page::not_shown"), "{words}");
        assert!(!folder.join("x.svg").exists());
    }
}

#[test]
fn a_single_figure_goes_where_its_ending_says() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    done(folder, &["simulate", "-o", "run.mcap", "--excite", "mid", "--duration", "6"]);
    let line = last(&done(folder, &["plot", "run.mcap", "--figure", "bode", "-o", "bode.svg", "--json"]));
    assert_eq!((&line["kind"], &line["figure"]), (&"plot".into(), &"bode".into()));
    let svg = fs::read_to_string(folder.join("bode.svg")).unwrap();
    assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>") && !svg.contains("var("), "{svg}");
    done(folder, &["plot", "run.mcap", "--figure", "loop", "-o", "loop.png"]);
    assert!(fs::read(folder.join("loop.png")).unwrap().starts_with(b"\x89PNG"));
    assert!(fails(folder, &["plot", "run.mcap", "--figure", "loop", "-o", "loop.png"], 8).contains("--force"));
    assert!(fails(folder, &["plot", "run.mcap", "--figure", "loop", "-o", "loop.pdf"], 2).contains(".svg"));
    assert!(fails(folder, &["plot", "run.mcap", "--figure", "cake", "-o", "x.svg"], 2).contains("residual"));
    assert!(fails(folder, &["plot", "none.mcap", "--figure", "loop", "-o", "x.svg"], 3).contains("none.mcap"));
    assert!(fails(folder, &["report", "run.mcap", "-o", "no/page.html"], 8).contains("make the folder"));
}

#[test]
fn the_paper_is_reproduced_the_same_each_time() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let line = last(&done(folder, &["reproduce-paper", "-o", "one", "--json"]));
    done(folder, &["reproduce-paper", "-o", "two"]);
    for name in ["reproduction.html", "figure-8.svg", "figure-9.png", "figure-10.svg", "figure-11.png"] {
        let [one, two] = ["one", "two"].map(|part| fs::read(folder.join(part).join(name)).unwrap());
        assert!(one == two && one.len() > 10_000, "{name}: {} bytes", one.len());
    }
    let page = checked(&folder.join("one/reproduction.html"));
    assert_eq!((count(&page, "figure > svg"), count(&page, ".differs"), count(&page, ".ok")), (4, 0, 6));
    let number = |pointer: &str| line.pointer(pointer).and_then(serde_json::Value::as_f64).unwrap();
    assert!((number("/parameters/inertance_kg/value") - 299.4906).abs() < number("/parameters/inertance_kg/u95"));
    assert_eq!(line["published_band_rad_per_s"], serde_json::json!([0.1, 40.0]));
    assert!(
        (1.0..1.5).contains(&number("/ideal_band_rad_per_s/0"))
            && (27.0..29.0).contains(&number("/ideal_band_rad_per_s/1"))
    );
    assert!(fails(folder, &["reproduce-paper", "-o", "one"], 8).contains("reproduction.html"));
}

#[test]
fn the_figure_in_the_readme_is_what_its_commands_draw() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let readme = fs::read_to_string(root.join("README.md")).unwrap();
    let folder = tempfile::tempdir().unwrap();
    for start in ["inerter simulate -o worn.mcap ", "inerter plot worn.mcap "] {
        let line = readme.lines().find(|line| line.starts_with(start)).unwrap();
        done(folder.path(), &line.split_whitespace().skip(1).collect::<Vec<_>>());
    }
    let drawn = fs::read_to_string(folder.path().join("worn.svg")).unwrap();
    let shown = fs::read_to_string(root.join("docs/worn.svg")).unwrap();
    assert!(drawn == shown, "docs/worn.svg is another figure; do what the README says in docs/ and commit worn.svg");
}
