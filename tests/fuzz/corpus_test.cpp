// Every seed and every former finding through its target: what was fixed stays fixed, and the
// targets stay in step with the parsers where no clang is.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

namespace fs = std::filesystem;

using Target = int(const std::uint8_t* data, std::size_t size);
extern "C" {
Target fuzz_calibration, fuzz_camera_answers, fuzz_daemon_answer, fuzz_effects, fuzz_exr,
    fuzz_fault_plan, fuzz_frame, fuzz_http_request, fuzz_journal, fuzz_manifest, fuzz_rig_file,
    fuzz_usb_records;
}

namespace {

struct NamedTarget {
  const char* name;
  Target* run;
};

constexpr NamedTarget kTargets[] = {
    {"calibration", fuzz_calibration},
    {"camera_answers", fuzz_camera_answers},
    {"daemon_answer", fuzz_daemon_answer},
    {"effects", fuzz_effects},
    {"exr", fuzz_exr},
    {"fault_plan", fuzz_fault_plan},
    {"frame", fuzz_frame},
    {"http_request", fuzz_http_request},
    {"journal", fuzz_journal},
    {"manifest", fuzz_manifest},
    {"rig_file", fuzz_rig_file},
    {"usb_records", fuzz_usb_records},
};

std::vector<fs::path> seeds_of(const std::string& target) {
  std::vector<fs::path> files;
  const fs::path folder = fs::path(SSRIG_FUZZ_CORPUS) / target;
  if (!fs::exists(folder)) return files;
  for (const auto& entry : fs::directory_iterator(folder)) files.push_back(entry.path());
  std::ranges::sort(files);
  return files;
}

std::vector<std::uint8_t> bytes_of(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

class FuzzCorpus : public testing::TestWithParam<NamedTarget> {};

TEST_P(FuzzCorpus, EverySeedEndsWell) {
  const std::vector<fs::path> seeds = seeds_of(GetParam().name);
  EXPECT_GE(seeds.size(), 2U) << "a target without seeds finds nothing";
  for (const fs::path& seed : seeds) {
    SCOPED_TRACE(seed.string());
    const std::vector<std::uint8_t> bytes = bytes_of(seed);
    EXPECT_EQ(GetParam().run(bytes.data(), bytes.size()), 0);
  }
}

// Cut short and with a byte changed here and there: a hint of what the fuzzer does at length.
TEST_P(FuzzCorpus, DamagedSeedsEndWell) {
  for (const fs::path& seed : seeds_of(GetParam().name)) {
    SCOPED_TRACE(seed.string());
    const std::vector<std::uint8_t> bytes = bytes_of(seed);
    const std::size_t step = bytes.size() / 40 + 1;
    for (std::size_t at = 0; at < bytes.size(); at += step) {
      EXPECT_EQ(GetParam().run(bytes.data(), at), 0);
      std::vector<std::uint8_t> changed = bytes;
      changed[at] ^= 0x15;
      EXPECT_EQ(GetParam().run(changed.data(), changed.size()), 0);
    }
  }
}

INSTANTIATE_TEST_SUITE_P(AllTargets, FuzzCorpus, testing::ValuesIn(kTargets),
                         [](const auto& target) { return std::string(target.param.name); });

TEST(FuzzFolders, EveryFolderHasItsTarget) {
  for (const auto& entry : fs::directory_iterator(SSRIG_FUZZ_CORPUS)) {
    const std::string name = entry.path().filename().string();
    EXPECT_TRUE(std::ranges::any_of(kTargets, [&](const auto& each) { return each.name == name; }))
        << name;
  }
}

}  // namespace
