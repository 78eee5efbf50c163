// tone: the tone curve l(p) = ln(1 + µp)/ln(1 + µ) and its inverse (design §2).

const MU: f32 = 5000.0; //!parameter
const LN_1P_MU: f32 = 8.517393; //!parameter

fn tone(p: f32) -> f32 {
    return log(1.0 + MU * p) / LN_1P_MU;
}

fn inverse_tone(v: f32) -> f32 {
    return (exp(v * LN_1P_MU) - 1.0) / MU;
}
