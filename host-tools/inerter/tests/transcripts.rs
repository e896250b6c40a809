//! The program's output as a person sees it: every `.trycmd` file in `tests/cmd` is a session with the expected output.
//! `TRYCMD=overwrite cargo test-lean --test transcripts` rewrites them.

/// Whether stores are supported, but not in S3; another package of the same build may enable S3.
#[cfg(feature = "tables")]
const LACKS_S3: bool = !inerter_store::HAS_S3;
#[cfg(not(feature = "tables"))]
const LACKS_S3: bool = false;

#[test]
fn transcripts() {
    let cases = trycmd::TestCases::new();
    cases.case("tests/cmd/*.trycmd");
    for (lacks, without) in [
        (!cfg!(feature = "probe"), "tests/cmd/*.without-probe.trycmd"),
        (!cfg!(feature = "bridges"), "tests/cmd/*.without-bridges.trycmd"),
        (!cfg!(feature = "reports"), "tests/cmd/*.without-reports.trycmd"),
        (!cfg!(feature = "tables"), "tests/cmd/*.without-tables.trycmd"),
        (LACKS_S3, "tests/cmd/*.without-s3.trycmd"),
    ] {
        if !lacks {
            cases.skip(without);
        }
    }
}
