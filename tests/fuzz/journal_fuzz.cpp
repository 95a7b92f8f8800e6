// journal.jsonl of a session: what a resumed capture believes of an earlier run.
#include <algorithm>

#include "capture/stored_take.h"
#include "tests/fuzz/fuzz_target.h"

namespace {

bool is_same(const capture::Journal& a, const capture::Journal& b) {
  const bool has_beginning = a.beginning.has_value();
  return a.frames.size() == b.frames.size() && has_beginning == b.beginning.has_value() &&
         (!has_beginning || (a.beginning->exposures == b.beginning->exposures &&
                             a.beginning->order == b.beginning->order &&
                             a.beginning->settings == b.beginning->settings));
}

}  // namespace

int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(fuzz::text_of(data, size));
  const capture::Journal journal = capture::parse_journal(text);
  estimation::check(!journal.beginning || !journal.beginning->exposures.empty(),
                    "a take is begun with its exposures");
  for (const auto& [file, frame] : journal.frames)
    estimation::check(frame.record.file == file && frame.record.pattern >= 0,
                      "a frame is known by its own file");
  if (!fuzz::is_in_share(data, size)) return 0;
  const std::string torn = text + "\n{\"event\": \"frame stored\", \"pattern\": 3, \"file\": \"fr";
  estimation::check(is_same(capture::parse_journal(torn), journal),
                    "a torn line changes nothing that is whole");
  return 0;
}
