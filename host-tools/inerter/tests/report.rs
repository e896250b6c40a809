//! Pages and figures from `report`, `plot` and `reproduce-paper`: they are valid and load nothing.

use std::{collections::BTreeSet, fs, path::Path};

use crate::common::{self, done, fails, last, run, text};
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

/// A page that is valid HTML, contains no nonsense, and loads nothing.
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
fn runs_are_compared_in_words_in_json_and_on_one_page() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let simulate = |name: &str, more: &[&str]| {
        done(folder, &[&["simulate", "-o", name, "--duration", "8", "--force-noise-n", "1"], more].concat());
    };
    simulate("a<b>.mcap", &["--seed", "1"]);
    simulate("heavier.mcap", &["--seed", "2", "--inertance-kg", "301"]);
    simulate("worn.mcap", &["--seed", "3", "--preset", "worn"]);
    simulate("silent.mcap", &["--seed", "4", "--excite", "hold"]);
    fs::write(folder.join("limits.toml"), "[inertance_kg]\nmin = 290\nmax = 310\n[backlash_m]\nmax = 2e-5\n").unwrap();
    let files = ["a<b>.mcap", "heavier.mcap", "worn.mcap", "silent.mcap"];
    let compare = |more: &[&str]| run(folder, &[&["compare"], &files[..], more].concat());
    let pages = ["-o", "page.html", "--png", "png", "--rigs", "one"];
    let output = compare(&[&pages[..], &["--json", "--limits", "limits.toml", "--junit", "r.xml"]].concat());
    assert_eq!(output.status.code(), Some(10), "{}", text(&output.stderr));
    assert!(
        text(&output.stderr)
            .contains("2 of 4 runs are not proven to be within the limits: 1 beyond a limit, 1 undecided")
    );
    let line = last(&text(&output.stdout));
    let same = serde_json::json!({"rig": "same", "reason": null});
    assert_eq!((&line["kind"], &line["files"]), (&"compare".into(), &files.as_slice().into()));
    assert_eq!(line["rigs"], serde_json::json!([same, same, same, same]));
    let of = |name: &str, run: usize| line["parameters"][name][run].clone();
    // The page shows the same values for each run as `replay`.
    let replayed = last(&done(folder, &["replay", "heavier.mcap", "--json"]));
    let (heavier, told) = (of("inertance_kg", 1), &replayed["uncertainty"]["inertance_kg"]);
    assert_eq!(
        (&heavier["u95"], &heavier["same_rig_u95"], &heavier["value"]),
        (&told["u95"], &told["same_rig_u95"], &replayed["whole_run"]["inertance_kg"]["value"])
    );
    assert_eq!(heavier["verdict"], "differs");
    let number = |of: &serde_json::Value| of.as_f64().unwrap();
    let (value, u95) = (number(&heavier["difference"]["value"]), number(&heavier["difference"]["u95"]));
    assert!((value - 1.5094).abs() < u95 && u95 < 0.1, "{heavier}");
    assert_eq!(of("inertance_kg", 3)["value"], serde_json::Value::Null);
    assert_eq!(of("inertance_kg", 3)["verdict"], "undecided");
    assert_eq!(
        (&of("backlash_m", 2)["verdict"], &of("coulomb_n", 1)["verdict"]),
        (&"differs".into(), &"not_shown".into())
    );
    let verdicts: Vec<_> = line["limits"].as_array().unwrap().iter().map(|limits| limits["verdict"].clone()).collect();
    assert_eq!(verdicts, ["pass", "pass", "fail", "undecided"]);
    let xml = fs::read_to_string(folder.join("r.xml")).unwrap();
    assert_eq!(xml.matches("<testsuite ").count(), 4, "{xml}");

    let page = checked(&folder.join("page.html"));
    let figures = ["intervals", "loops", "over-time", "bode"];
    let expected = ["runs", "parameters", "limits", "settings", "method"].into_iter().chain(figures);
    assert!(expected.clone().all(|section| sections(&page).contains(section)), "{:?}", sections(&page));
    assert_eq!((count(&page, "figure > svg"), count(&page, "#limits")), (4, 1), "an id is there once");
    for name in figures {
        assert!(fs::read(folder.join("png").join(format!("{name}.png"))).unwrap().starts_with(b"\x89PNG"), "{name}");
    }
    assert!(count(&page, "#parameters td.differs") >= 2 && count(&page, "#runs tbody tr") == 4);

    // Without information on the rig, the boards decide: each simulated device has its own serial number.
    let output = compare(&[]);
    let words = text(&output.stdout);
    let other = "heavier.mcap is from another rig than a<b>.mcap (the serial number of the board differs): its full intervals are used.";
    assert!(words.contains(other), "{words}");
    assert!(words.contains("+1.5 ± 2.2   no difference shown"), "{words}");

    assert!(fails(folder, &["compare", "worn.mcap"], 2).contains("2 values required"));
    simulate("rotary.mcap", &["--preset", "paper", "--set", "machine=1"]);
    let refused = fails(folder, &["compare", "worn.mcap", "rotary.mcap"], 4);
    assert!(refused.contains("worn.mcap is of a linear machine and rotary.mcap of a rotary one"), "{refused}");
    assert!(fails(folder, &["compare", "worn.mcap", "none.mcap"], 3).contains("none.mcap"));
    let before = fs::read(folder.join("page.html")).unwrap();
    assert_eq!(compare(&["-o", "page.html"]).status.code(), Some(8));
    let recording = fs::read(folder.join("worn.mcap")).unwrap();
    let written = [["-o", "worn.mcap"], ["-o", "./worn.mcap"], ["-o", "limits.toml"], ["--junit", "worn.mcap"]];
    for words in written {
        let output = compare(&[&words[..], &["--limits", "limits.toml", "--force"]].concat());
        assert_eq!(output.status.code(), Some(8), "{words:?}");
        assert!(text(&output.stderr).contains("is another file of this command"), "{}", text(&output.stderr));
    }
    assert!(
        fails(folder, &["report", "worn.mcap", "-o", "./worn.mcap", "--force"], 8)
            .contains("is another file of this command")
    );
    assert_eq!(recording, fs::read(folder.join("worn.mcap")).unwrap());
    assert_eq!(before, fs::read(folder.join("page.html")).unwrap());
}

/// No more than five colours are distinguishable with all kinds of colour vision.
#[test]
fn of_six_runs_all_are_compared_and_the_first_five_are_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    done(folder, &["simulate", "-o", "run.mcap", "--duration", "5"]);
    let words = [&["compare", "-o", "page.html", "--json"][..], &["run.mcap"; 6]].concat();
    let line = last(&done(folder, &words));
    assert_eq!(line["parameters"]["inertance_kg"].as_array().unwrap().len(), 6);
    assert_eq!(count(&checked(&folder.join("page.html")), "#runs tbody tr"), 6);
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    // All figures but that of the intervals, which has room for all runs.
    assert_eq!(page.matches("Only the first 5 of 6 runs are drawn.").count(), 3);
}

/// The exit code does not depend on whether anybody reads the output.
#[test]
fn a_verdict_needs_no_reader() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    done(folder, &["simulate", "-o", "run.mcap", "--duration", "5"]);
    done(folder, &["store", "add", "store", "run.mcap"]);
    fs::write(folder.join("limits.toml"), "[inertance_kg]\nmax = 1\n").unwrap();
    for command in [
        &["report", "run.mcap", "-o", "page.html"][..],
        &["report", "run.mcap", "-o", "other.html", "--json"],
        &["compare", "run.mcap", "run.mcap"],
        &["compare", "run.mcap", "run.mcap", "--json"],
        &["store", "ls", "store"],
        &["store", "ls", "store", "--json"],
    ] {
        let mut child = common::inerter(folder, &[command, &["--limits", "limits.toml"]].concat())
            .stderr(std::process::Stdio::null())
            .spawn()
            .unwrap();
        drop(child.stdout.take());
        assert_eq!(child.wait().unwrap().code(), Some(10), "{command:?}");
    }
}

/// A rotary machine has its own names and units in comparisons and verdicts.
#[test]
fn a_rotary_machine_is_compared_by_its_own_names() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (name, seed) in [("a.mcap", "1"), ("b.mcap", "2")] {
        done(folder, &["simulate", "-o", name, "--duration", "8", "--seed", seed, "--set", "machine=1"]);
    }
    fs::write(folder.join("limits.toml"), "[inertia_kg_m2]\nmax = 200\n[backlash_rad]\nmax = 1\n").unwrap();
    let words = ["compare", "a.mcap", "b.mcap", "--rigs", "one", "--limits", "limits.toml"];
    let output = run(folder, &words);
    let told = text(&output.stdout);
    assert_eq!(output.status.code(), Some(10), "{told}");
    assert!(told.contains("Effective inertia [kg m²]") && told.contains("Backlash [µrad]"), "{told}");
    assert!(told.contains("FAIL       Effective inertia: 299"), "{told}");
    let line = last(&text(&run(folder, &[&words[..], &["--json", "-o", "page.html"]].concat()).stdout));
    let keys: Vec<&String> = line["parameters"].as_object().unwrap().keys().collect();
    assert_eq!(keys, ["inertia_kg_m2", "viscous_n_m_s", "coulomb_n_m", "offset_n_m", "backlash_rad"]);
    assert_eq!(line["limits"][0]["parameters"][1]["parameter"], "inertia_kg_m2");
    let page = fs::read_to_string(folder.join("page.html")).unwrap();
    assert!(page.contains("Torque [N m]") && !page.contains("Force [N]") && !page.contains("inertance"), "{page}");
    let reported = run(folder, &["report", "a.mcap", "-o", "a.html", "--json", "--limits", "limits.toml"]);
    assert_eq!(last(&text(&reported.stdout))["limits"], line["limits"][0]);
}

/// The verdict equals that of `replay`, with bad samples in the last minute or without any.
#[test]
fn a_page_says_what_a_replay_says_of_limits() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    // Longer than the span of latest samples that is searched.
    let simulate = ["simulate", "-o", "run.mcap", "--duration", "80", "--force-noise-n", "1", "--seed", "5"];
    done(folder, &simulate);
    fs::write(
        folder.join("limits.toml"),
        "[inertance_kg]\nmax = 299.6\n[coulomb_n]\nmax = 45\n[backlash_m]\nmax = 1e-4\n",
    )
    .unwrap();
    let limits = ["--limits", "limits.toml", "--json"];
    let of = |words: &[&str]| {
        let output = run(folder, &[words, &limits[..]].concat());
        assert_eq!(output.status.code(), Some(10), "{words:?}");
        last(&text(&output.stdout))["limits"].clone()
    };
    let replayed = of(&["replay", "run.mcap"]);
    assert_eq!(of(&["report", "run.mcap", "-o", "page.html"]), replayed);
    done(folder, &["store", "add", "store", "run.mcap"]);
    assert_eq!(of(&["store", "ls", "store"]), replayed);
    let compared = of(&["compare", "run.mcap", "run.mcap"]);
    assert_eq!(compared, serde_json::json!([replayed, replayed]));
    // The files agree too. Each contains the name of the run, which differs in a store.
    let files = |words: &[&str], name: &str| {
        let names = ["xml", "csv"].map(|ending| format!("{name}.{ending}"));
        let limits = ["--limits", "limits.toml", "--junit", &names[0], "--verdicts", &names[1]];
        let output = run(folder, &[words, &limits].concat());
        assert_eq!(output.status.code(), Some(10), "{words:?}: {}", text(&output.stderr));
        names.map(|name| fs::read_to_string(folder.join(name)).unwrap())
    };
    let of_replay = files(&["replay", "run.mcap"], "replay");
    let [xml, csv] = &of_replay;
    assert!(xml.contains("tests=\"3\" skipped=\"0\" failures=\"1\" errors=\"1\""), "{xml}");
    assert_eq!(files(&["report", "run.mcap", "-o", "page.html", "--force"], "report"), of_replay);
    let name = last(&done(folder, &["store", "ls", "store", "--json"]))["run"].as_str().unwrap().to_string();
    assert_eq!(files(&["store", "ls", "store"], "store").map(|file| file.replace(&name, "run.mcap")), of_replay);
    let [both, rows] = files(&["compare", "run.mcap", "run.mcap"], "compare");
    let (suite, row) = ("<testsuite name=\"run.mcap\" tests=\"3\"", csv.split_once('\n').unwrap().1);
    assert_eq!((both.matches(suite).count(), xml.matches(suite).count()), (2, 1), "{both}");
    assert_eq!(rows, format!("{csv}{row}"));
    // A broken law, a device that changed, bad samples.
    let change = ["--change-at", "4", "--change", "inertance_kg=150"];
    let clipped = ["--set", "force_max_code=200000", "--set", "force_min_code=-200000"];
    for (name, more) in
        [("broken", &["--delay-s", "0.004", "--set", "skew_s=0"][..]), ("changed", &change), ("wrong", &clipped)]
    {
        let file = format!("{name}.mcap");
        done(folder, &[&["simulate", "-o", &file, "--duration", "10", "--excite", "random"], more].concat());
        let limits = ["--limits", "limits.toml", "--json"];
        let of = |words: &[&str]| last(&text(&run(folder, &[words, &limits[..]].concat()).stdout))["limits"].clone();
        let replayed = of(&["replay", &file]);
        assert_eq!(of(&["report", &file, "-o", &format!("{name}.html")]), replayed, "{name}");
        assert_eq!(of(&["compare", &file, "run.mcap"])[0], replayed, "{name}");
        let store = format!("store-{name}");
        done(folder, &["store", "add", &store, &file]);
        assert_eq!(of(&["store", "ls", &store]), replayed, "{name}");
        println!("{name}: {replayed}");
    }
    let page = checked(&folder.join("page.html"));
    let words: String = page.select(&Selector::parse("#limits").unwrap()).flat_map(|limits| limits.text()).collect();
    for said in ["Limits: fail", "Coulomb frictionN4550.0", "inerter plan run.mcap --want \"mt to 0.1"] {
        assert!(words.contains(said), "{said}: {words}");
    }
    done(folder, &["report", "run.mcap", "-o", "plain.html"]);
    assert_eq!(count(&checked(&folder.join("plain.html")), "#limits"), 0);
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
