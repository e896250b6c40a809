//! Constants of the method that a host's own fits and figures share with the estimator: see docs/THEORY.md.

/// Standard errors in the interval of a complete model's parameters and of a cause's size: 1.96 would do for
/// white noise alone. What the device tells has a budget (`budget.rs`).
pub const COVERAGE: f64 = 3.0;
/// What the estimator itself goes on with has no wider interval than this part of its value.
pub const WIDEST_INTERVAL: f64 = 0.5;
/// Part of the variance that rounding to force codes and encoder counts leaves in a residual, under which a fit is exact:
/// every motion of the grid leaves more than 0.64 of it.
pub const EXACT: f64 = 0.25;
/// Variance of the rounding to a whole number.
pub const ROUNDING: f64 = 1.0 / 12.0;
/// Lower quartile, median and upper quartile of the magnitude of normal noise's fourth differences, per its rms: 0.3186, 0.6745 and
/// 1.1503 times the root of 70.
pub const QUARTILES: [f64; 3] = [2.666, 5.643, 9.624];
/// Least noise whose absence can be told from the rounding \[codes, rms\].
pub const LEAST_NOISE: f64 = 0.7;
/// Codes that count as piled up lie within half the noise's rms of the extreme, those they are compared with within so many
/// times as much.
pub const PILED_WITHIN: i32 = 16;
/// Codes within which a force stands still.
pub const STILL_CODES: u32 = 2;
/// Reversals of the screw that no force leaves without a trace.
pub const DEAD_REVERSALS: u8 = 6;
/// Variance of white noise through four boxes, times their length: the cubic B-spline's autocorrelation at 0.
pub const BOXES_VARIANCE: f64 = 151.0 / 315.0;
/// Times that a parameter moves by beyond chance between the fit to all and the one away from rest, which it may be wrong by.
pub const MOVED: f64 = 1.4;
/// Model error of the structure mass where the gap is not known: across a backlash its motion does not follow from the force.
/// 0.1 mm takes up to 4.8 % of it from the inertance (docs/tables/accuracy.md, `worn`).
pub const STRUCTURE_MODEL_U95: f64 = 0.05;
/// Uncertainty of a stiffness that is given without one, as a part of it.
pub const UNSTATED_STIFFNESS_U95: f64 = 0.01;
/// Regressors of which the others leave less than `2^-PIVOT_BITS` of their square cannot be told apart.
pub const PIVOT_BITS: u32 = 20;

/// Length of the fast bank's box \[s\]: the encoder's steps in the acceleration fall with its 2.5th power, and at 16 Hz
/// the kernel still passes 64 %. 12 ms doubles the scatter of viscous friction at 3.2 Hz; 20 ms takes a tenth to a fifth
/// off it with coarse encoders, but the EMPS record, which stops often, comes out 1.6 % off.
pub const FAST_BOX_S: f64 = 0.016;
/// Length of the slow bank's box \[s\]: four of them are lost around each rest, so no longer than the steps ask for.
pub const SLOW_BOX_S: f64 = 0.064;
/// Acceleration's mean square over that of the encoder's steps above which the fast bank is published.
pub const CLEAR_OF_STEPS: f64 = 2000.0;
/// Updates in one box: two, as the kernel leaves nothing above the half of that rate.
pub const UPDATES_PER_BOX: u32 = 2;
/// Sum of the cubic B-spline's autocorrelation over its value at 0, in boxes: updates within it are one observation.
pub const CORRELATION_BOXES: f64 = 2.09;

/// Longest spacing of a bank's updates \[samples\]: a box of 512 samples keeps the comb within 64 bits.
pub const LONGEST_SPACING: f64 = 256.0;
/// Correction taps of the force, before they are divided by their sum: Numerov's, as the next two.
pub const FORCE_TAPS: [f64; 3] = [1.0, 10.0, 1.0];
/// Correction taps of first derivatives.
pub const RATE_TAPS: [f64; 4] = [-1.0, 13.0, 13.0, -1.0];
/// Correction taps of the sign.
pub const SIGN_TAPS: [f64; 3] = [1.0, 22.0, 1.0];

/// Half width of the triangular kernel of the sign \[s\]: shorter ones are noisy, longer ones lean on the correction.
pub const SIGN_KERNEL_S: f64 = 0.005;
/// Half width of the triangular kernel that locates a reversal anew once its surroundings are known \[s\]: 5 ms leaves
/// a scatter of the inertance at 3.2 Hz of 3 times what the force noise does, 15 ms of 1.8 times, 22 ms of 1.7 times.
pub const REVERSAL_KERNEL_S: f64 = 0.015;
/// How far the zero may lie from where the short kernel saw it \[s\]: other reversals come as close as twice that.
pub const REVERSAL_REACH_S: f64 = 0.002;
/// Window in which standing still is decided \[s\].
pub const REST_WINDOW_S: f64 = 0.024;
/// Encoder counts within the window that still are rest: a flicker of one count, and one on its way.
pub const REST_COUNTS: f64 = 2.0;
