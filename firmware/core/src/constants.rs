//! Constants of the method that the host's own fits and figures share with the estimator: see docs/THEORY.md.

/// Half width, in standard errors, of the intervals of a complete model's parameters and of a cause's size. 1.96 would
/// suffice for white noise alone. Intervals on the device come from a budget (`budget.rs`).
pub const COVERAGE: f64 = 3.0;
/// The estimator itself uses only values whose interval is within this fraction of the value.
pub const WIDEST_INTERVAL: f64 = 0.5;
/// A fit is exact if its residual's variance is below this fraction of what rounding to force codes and encoder counts
/// leaves. Every motion of the grid leaves more than 0.64 of it.
pub const EXACT: f64 = 0.25;
/// Variance of the rounding to a whole number.
pub const ROUNDING: f64 = 1.0 / 12.0;
/// Lower quartile, median and upper quartile of the magnitude of normal noise's fourth differences, over the noise's
/// rms: 0.3186, 0.6745 and 1.1503 times the square root of 70.
pub const QUARTILES: [f64; 3] = [2.666, 5.643, 9.624];
/// Least noise that can be distinguished from rounding alone \[codes, rms\].
pub const LEAST_NOISE: f64 = 0.7;
/// Codes within half of the noise's rms of the extreme count as piled up. They are compared with those within this many
/// times that distance.
pub const PILED_WITHIN: i32 = 16;
/// A force that stays within this many codes stands still.
pub const STILL_CODES: u32 = 2;
/// Reversals of the screw after which a force that stands still is dead.
pub const DEAD_REVERSALS: u8 = 6;
/// Variance of white noise through four boxes, times their length: the cubic B-spline's autocorrelation at 0.
pub const BOXES_VARIANCE: f64 = 151.0 / 315.0;
/// A parameter may be wrong by this many times what it moves beyond chance between the fit to all updates and the fit
/// to those away from rest.
pub const MOVED: f64 = 1.4;
/// Relative model error of the structure mass where the gap is not known: across a backlash, the structure's motion
/// does not follow from the force. A gap of 0.1 mm takes up to 4.8 % of that mass from the inertance
/// (docs/tables/accuracy.md, `worn`).
pub const STRUCTURE_MODEL_U95: f64 = 0.05;
/// Relative uncertainty of a stiffness that is given without one.
pub const UNSTATED_STIFFNESS_U95: f64 = 0.01;
/// A regressor of which the others leave less than `2^-PIVOT_BITS` of its square cannot be distinguished from them.
pub const PIVOT_BITS: u32 = 20;

/// Length of the fast bank's box \[s\]: the encoder's steps in the acceleration fall with its 2.5th power, and at 16 Hz
/// the kernel still passes 64 %. 12 ms doubles the scatter of viscous friction at 3.2 Hz. 20 ms reduces it by a tenth
/// to a fifth with coarse encoders, but the result for the EMPS record, which stops often, is then 1.6 % off.
pub const FAST_BOX_S: f64 = 0.016;
/// Length of the slow bank's box \[s\]: four of them are lost around each rest, so it is only as long as the steps
/// require.
pub const SLOW_BOX_S: f64 = 0.064;
/// Ratio of the acceleration's mean square to that of the encoder's steps above which the fast bank is published.
pub const CLEAR_OF_STEPS: f64 = 2000.0;
/// Updates in one box: two, because the kernel passes nothing above half of that rate.
pub const UPDATES_PER_BOX: u32 = 2;
/// Sum of the cubic B-spline's autocorrelation over its value at 0, in boxes: updates within it count as one
/// observation.
pub const CORRELATION_BOXES: f64 = 2.09;

/// Longest spacing of a bank's updates \[samples\]: a box of 512 samples keeps the comb within 64 bits.
pub const LONGEST_SPACING: f64 = 256.0;
/// Correction taps of the force, not yet divided by their sum: Numerov's, as are the next two.
pub const FORCE_TAPS: [f64; 3] = [1.0, 10.0, 1.0];
/// Correction taps of first derivatives.
pub const RATE_TAPS: [f64; 4] = [-1.0, 13.0, 13.0, -1.0];
/// Correction taps of the sign.
pub const SIGN_TAPS: [f64; 3] = [1.0, 22.0, 1.0];

/// Half width of the triangular kernel of the sign \[s\]: shorter ones are noisier, longer ones depend more on the
/// correction.
pub const SIGN_KERNEL_S: f64 = 0.005;
/// Half width of the triangular kernel that relocates a reversal once the signs on both sides are known \[s\]. With
/// 5 ms the scatter of the inertance at 3.2 Hz is 3 times what the force's noise causes, with 15 ms 1.8 times, with
/// 22 ms 1.7 times.
pub const REVERSAL_KERNEL_S: f64 = 0.015;
/// How far a relocated zero may lie from that of the short kernel \[s\]: other reversals come as close as twice that.
pub const REVERSAL_REACH_S: f64 = 0.002;
/// Window over which rest is detected \[s\].
pub const REST_WINDOW_S: f64 = 0.024;
/// Encoder counts within the window that still count as rest: a flicker of one count, and one count of travel.
pub const REST_COUNTS: f64 = 2.0;
