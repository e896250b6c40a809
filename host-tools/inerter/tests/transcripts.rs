//! What a person sees: every `.trycmd` file in `tests/cmd` is a session whose output must stay as it is written there.
//! `TRYCMD=overwrite cargo test-lean --test transcripts` writes them anew.

#[test]
fn transcripts() {
    let cases = trycmd::TestCases::new();
    cases.case("tests/cmd/*.trycmd");
    for (built_in, without) in [
        (cfg!(feature = "probe"), "tests/cmd/*.without-probe.trycmd"),
        (cfg!(feature = "bridges"), "tests/cmd/*.without-bridges.trycmd"),
        (inerter_store::HAS_S3, "tests/cmd/*.without-s3.trycmd"),
    ] {
        if built_in {
            cases.skip(without);
        }
    }
}
