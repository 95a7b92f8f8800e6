// How phases of one pixel are brought together, whoever does it.
#pragma once

namespace estimation {

// Two phases of one pixel agree within this many standard deviations plus the slack, or are not
// combined; light that enters obliquely comes out shifted by up to a px.
inline constexpr double kAgreementSd = 4;
inline constexpr double kAgreementSlackPx = 1;
// No phase counts as better than this, whatever the noise options say.
inline constexpr float kLeastSdPx = 1e-3F;
// How far beyond the projector's first and last pixel centre a coordinate may lie.
inline constexpr double kOutsidePx = 1.25;

}  // namespace estimation
