#include "capture/runner.h"

#include <algorithm>
#include <chrono>
#include <deque>
#include <map>
#include <memory>
#include <utility>

namespace capture {
namespace {

// How often a failure of the consumer is looked for when nothing else happens.
constexpr std::chrono::milliseconds kConsumerCheckPeriod{100};
// Flips that teach the lag, and must agree; and where nothing else tells our flips.
constexpr int kLessons = 2, kSoleLessons = 4;
constexpr int kSoleRounds = 2;  // one to listen after

int priming_rounds(const LedgerRules& rules) {
  const int flips_a_round = static_cast<int>(rules.exposures.size()) / rules.brackets_per_showing();
  const int lessons = rules.relies_on_swaps ? kSoleLessons : kLessons;
  const int least = rules.relies_on_swaps ? kSoleRounds : 1;
  return std::max((lessons + flips_a_round - 1) / flips_a_round, least);
}

bool relies_on_swaps(const Devices& devices, const LedgerRules& rules) {
  return rules.has_edge_per_bracket && !devices.camera.identity().tells_line_level;
}

RunResult refused(const rig::Error& error) {
  RunResult result;
  result.failure =
      Failure{incident_of(error.fault), rig::Device::kProjector, {}, "projector: " + error.detail};
  return result;
}

class Runner {
 public:
  Runner(Devices devices, const Plan& plan, const SequenceRules& rules, FrameConsumer& consumer,
         const OnTransition& on_transition)
      : devices_(devices),
        plan_(plan),
        consumer_(consumer),
        on_transition_(on_transition),
        sequence_(as_devices_allow(rules, devices), plan.order),
        state_(sequence_.initial()) {}

  RunResult run(const std::stop_token& stop) {
    feed(Start{});
    while (!std::holds_alternative<Ended>(state_.phase)) {
      if (stop.stop_requested() && !is_abort_told_) {
        is_abort_told_ = true;
        feed(AbortRequested{});
      } else if (const auto failure = consumer_.failure(); failure && !is_failure_told_) {
        is_failure_told_ = true;
        feed(StorageFailed{*failure});
      } else {
        wait_and_feed(is_abort_told_ ? std::stop_token() : stop);
      }
    }
    return {state_.outcome,       state_.failure,       state_.ledger.slots(),
            retake_count(state_), state_.restart_count, state_.reopen_count};
  }

 private:
  static SequenceRules as_devices_allow(SequenceRules rules, const Devices& devices) {
    if (devices.reopener == nullptr) rules.reopen_deadline = std::chrono::milliseconds(0);
    rules.ledger.relies_on_swaps = relies_on_swaps(devices, rules.ledger);
    // Flips that do not wait for each other's edges are told apart by level and time together.
    if (rules.ledger.relies_on_swaps) rules.refreshes_per_showing.clear();
    if (rules.ledger.is_lag_checked) rules.ledger.priming_rounds = priming_rounds(rules.ledger);
    return rules;
  }

  void wait_and_feed(const std::stop_token& stop) {
    const rig::HostTime check_time = devices_.events.now() + kConsumerCheckPeriod;
    const rig::HostTime deadline = Sequence::deadline(state_).value_or(check_time);
    auto event = devices_.events.wait(std::min(deadline, check_time), stop);
    if (event)
      std::visit([this](auto& e) { feed(translate(std::move(e))); }, *event);
    else
      feed(TimePassed{});
  }

  template <typename DeviceEvent>
  SequenceEvent translate(DeviceEvent event) {
    return event;
  }
  // The pixels stay here until the ledger has decided whose they are.
  SequenceEvent translate(rig::FrameArrived arrived) {
    const rig::Frame& frame = arrived.frame;
    const FrameFacts facts{next_ticket_++, frame.block_id, frame.timestamp,
                           frame.received, frame.exposure, frame.trigger_count};
    frames_.emplace(facts.ticket, std::move(arrived.frame));
    return FrameSeen{facts};
  }
  SequenceEvent translate(rig::DeviceOpened opened) {
    const auto answer =
        devices_.reopener == nullptr ? std::nullopt : devices_.reopener->finish(opened.device);
    if (!answer) return TimePassed{};  // an earlier capture's, and taken already
    if (*answer) return Reopened{opened.device};
    return ReopenRefused{opened.device, answer->error()};
  }

  void feed(SequenceEvent event) {
    pending_.push_back(std::move(event));
    while (!pending_.empty()) {
      const SequenceEvent next = std::move(pending_.front());
      pending_.pop_front();
      const std::string_view from = name_of(state_.phase);
      const rig::HostTime now = devices_.events.now();
      Step step = sequence_.next(std::move(state_), next, now);
      state_ = std::move(step.state);
      on_transition_({now, next, from, state_, step.reacted});
      for (const Action& action : step.actions)
        std::visit([this](const auto& a) { act(a); }, action);
    }
  }

  void act(const Show& show) {
    if (const auto shown = devices_.projector.show(show.request); !shown)
      pending_.push_back(CommandRefused{rig::Device::kProjector, shown.error()});
  }
  void act(const Arm& arm) {
    if (const auto armed = devices_.camera.arm(plan_.exposures, arm.frame_count); !armed)
      pending_.push_back(CommandRefused{rig::Device::kCamera, armed.error()});
    else if (const auto fires = devices_.trigger.arm(plan_.exposures, arm.run_id); !fires)
      pending_.push_back(CommandRefused{devices_.trigger.device(), fires.error()});
    else
      pending_.push_back(Armed{});
  }
  void act(const Fire&) {
    if (const auto fired = devices_.camera.trigger_software(); !fired)
      pending_.push_back(CommandRefused{rig::Device::kCamera, fired.error()});
  }
  void act(const Disarm&) {
    devices_.trigger.disarm();
    devices_.camera.disarm();
    frames_.clear();
  }
  void act(const Reopen& reopen) { devices_.reopener->reopen(reopen.device); }
  void act(const KeepFrame& keep) {
    const auto found = frames_.find(keep.ticket);
    const auto bracket = static_cast<std::size_t>(keep.slot.bracket);
    consumer_.consume({keep.slot, plan_.exposures[bracket], keep.evidence,
                       std::make_shared<const rig::Frame>(std::move(found->second))});
    frames_.erase(found);
  }
  void act(const DropFrame& drop) { frames_.erase(drop.ticket); }

  Devices devices_;
  const Plan& plan_;
  FrameConsumer& consumer_;
  const OnTransition& on_transition_;
  const Sequence sequence_;
  SequenceState state_;
  std::deque<SequenceEvent> pending_;           // answers to actions, next first
  std::map<std::uint64_t, rig::Frame> frames_;  // by ticket, not yet decided about
  std::uint64_t next_ticket_ = 1;
  bool is_abort_told_ = false;
  bool is_failure_told_ = false;
};

// Beyond exposures and readout: edges that are seen late, such as a slow photodiode's.
constexpr std::chrono::microseconds kPaceMargin{5000};
// Fewer, and an edge could be taken for its neighbour's.
constexpr int kFewestRefreshes = 3;

// Refreshes from swap to swap, for each showing of a pattern. One more than its exposures take: the
// sync square is scanned out last, so it flips a refresh after the next picture's first row.
std::vector<int> paced_refreshes(const rig::RigFile& rig_file, const LedgerRules& rules) {
  std::vector<int> refreshes;
  const auto bracket_count = static_cast<int>(rules.exposures.size());
  for (int first = 0; first < bracket_count; first += rules.brackets_per_showing()) {
    std::chrono::nanoseconds busy = rig_file.sequence.readout + kPaceMargin;
    for (int bracket = first; bracket < first + rules.brackets_per_showing(); ++bracket)
      busy += rules.exposures[static_cast<std::size_t>(bracket)] +
              (bracket > first ? rules.gap : std::chrono::microseconds(0));
    if (!rules.has_edge_per_bracket)
      busy += std::max(rig_file.trigger.delay_rise, rig_file.trigger.delay_fall);
    const auto whole =
        (busy + rules.refresh_interval - std::chrono::nanoseconds(1)) / rules.refresh_interval;
    refreshes.push_back(std::max(static_cast<int>(whole) + 1, kFewestRefreshes));
  }
  return refreshes;
}

}  // namespace

int retake_count(const SequenceState& state) { return state.retake_total; }

SequenceRules make_rules(const rig::RigFile& rig_file,
                         const std::vector<std::chrono::microseconds>& exposures,
                         double refresh_hz) {
  SequenceRules rules;
  rules.ledger.exposures = exposures;
  rules.ledger.has_edge_per_bracket = rig_file.sequence.sync != rig::SyncMode::kTriggerBox;
  rules.ledger.gap =
      rules.ledger.has_edge_per_bracket ? rig_file.sequence.readout : rig_file.trigger.gap;
  rules.ledger.debounce = rig_file.trigger.debounce;
  rules.ledger.frame_deadline = rig_file.sequence.frame_deadline;
  if (refresh_hz > 0)
    rules.ledger.refresh_interval =
        std::chrono::nanoseconds(static_cast<std::int64_t>(1e9 / refresh_hz));
  rules.bracketing = rig_file.camera.bracketing;
  rules.ledger.edge_deadline = rig_file.sequence.edge_deadline;
  rules.retake_limit = rig_file.sequence.retake_limit;
  rules.reopen_deadline = rig_file.sequence.reopen_deadline;
  const bool is_paced = rig_file.sequence.pace == rig::Pace::kPaced;
  rules.ledger.is_lag_checked = is_paced || rig_file.sequence.sync == rig::SyncMode::kCameraLine;
  if (is_paced) rules.refreshes_per_showing = paced_refreshes(rig_file, rules.ledger);
  return rules;
}

rig::Result<void> check_display(const Devices& devices, const LedgerRules& rules) {
  if (!relies_on_swaps(devices, rules)) return {};
  const rig::DisplayReport report = devices.projector.report();
  if (report.is_vsynced) return {};
  return rig::failure(rig::Fault::kUnsupported,
                      report.text +
                          "; without a trigger box, and a camera that tells the level of its line "
                          "(chunk LineStatusAll), nothing else says which picture a frame is of: "
                          "set sequence.sync to \"trigger_box\", or have the display keep time");
}

RunResult run_capture(Devices devices, const Plan& plan, const rig::ProjectorSettings& projector,
                      const SequenceRules& rules, FrameConsumer& consumer,
                      const std::stop_token& stop, const OnTransition& on_transition) {
  if (const auto checked = check_display(devices, rules.ledger); !checked)
    return refused(checked.error());
  if (const auto loaded = devices.projector.load(render_pictures(plan, projector)); !loaded)
    return refused(loaded.error());
  return Runner(devices, plan, rules, consumer, on_transition).run(stop);
}

}  // namespace capture
