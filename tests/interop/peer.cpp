// A robot in a room, or a listener, on Fast DDS with the types of ROS 2. It prints the time of joining and, at its end, one line of JSON.
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/publisher/qos/DataWriterQos.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/DataReaderListener.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/subscriber/qos/DataReaderQos.hpp>
#include <fastrtps/utils/IPLocator.h>
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <mutex>
#include <string>
#include <thread>
#include <vector>
#include "rosPubSubTypes.h"

using namespace eprosima::fastdds::dds;
using eprosima::fastrtps::rtps::IPLocator;
using eprosima::fastrtps::rtps::Locator_t;
using Clock = std::chrono::steady_clock;
namespace sensor = sensor_msgs::msg::dds_;
namespace geometry = geometry_msgs::msg::dds_;
namespace nav = nav_msgs::msg::dds_;
namespace tf = tf2_msgs::msg::dds_;

struct Options {
    int domain = 0, beams = 360;
    double seconds = 20.0, hz = 10.0, ahead_s = 0.0;
    bool listens = false, obeys = false, is_best_effort = false, takes_map = true;
    std::string peer;
};

struct Motion { double x = 0.3, y = -0.2, theta = 0.4; };

std::atomic<bool> is_over{false};
std::mutex lock;  // of what the listeners have heard
const auto began = Clock::now();
double since_s() { return std::chrono::duration<double>(Clock::now() - began).count(); }

// What is heard of a topic: how often, when for the first time, and the gaps between.
struct Heard {
    int count = 0;
    double first_s = -1.0, last_s = 0.0;
    std::vector<double> gaps;
    void now() {
        const double t = since_s();
        if (count++ == 0) first_s = t; else gaps.push_back(t - last_s);
        last_s = t;
    }
    double gap(double share) {
        if (gaps.empty()) return -1.0;
        std::sort(gaps.begin(), gaps.end());
        return gaps[std::min(gaps.size() - 1, size_t(share * gaps.size()))];
    }
};
std::map<std::string, Heard> heard;
std::map<long long, Motion> truth;  // by stamp, ns
double worst_m = 0.0, speed = 0.0, turn_rate = 0.0, commanded_s = -1.0;
size_t map_bytes = 0, obstacles = 0;

long long stamp_of(const std_msgs::msg::dds_::Header_& h) { return 1000000000LL * h.stamp().sec() + h.stamp().nanosec(); }

void take(const geometry::PoseWithCovarianceStamped_& m) {
    auto after = truth.lower_bound(stamp_of(m.header()) - 30000000LL);
    if (after == truth.end()) return;
    const auto& at = m.pose().pose().position();
    worst_m = std::max(worst_m, std::hypot(at.x() - after->second.x, at.y() - after->second.y));
}
void take(const nav::OccupancyGrid_& m) {
    map_bytes = m.data().size();
    obstacles = std::count(m.data().begin(), m.data().end(), 100);
}
void take(const tf::TFMessage_&) {}
void take(const geometry::Twist_& m) {
    speed = m.linear().x(); turn_rate = m.angular().z(); commanded_s = since_s();
}

template <class T> class Listener : public DataReaderListener {
public:
    explicit Listener(std::string name) : name_(std::move(name)) {}
    void on_data_available(DataReader* reader) override {
        T message; SampleInfo info;
        while (reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            std::lock_guard<std::mutex> guard(lock);
            heard[name_].now();
            take(message);
        }
    }
private:
    std::string name_;
};

class Peer {
public:
    explicit Peer(const Options& o) {
        DomainParticipantQos qos;
        if (!o.peer.empty()) {
            Locator_t locator;
            IPLocator::setIPv4(locator, o.peer);
            qos.wire_protocol().builtin.initialPeersList.push_back(locator);
        }
        participant_ = DomainParticipantFactory::get_instance()->create_participant(o.domain, qos);
        publisher_ = participant_->create_publisher(PUBLISHER_QOS_DEFAULT);
        subscriber_ = participant_->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    }
    ~Peer() {
        participant_->delete_contained_entities();
        DomainParticipantFactory::get_instance()->delete_participant(participant_);
    }
    template <class Type> DataWriter* writer(const std::string& name, bool is_reliable, bool is_latched = false) {
        DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
        qos.reliability().kind = is_reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
        qos.durability().kind = is_latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
        qos.history().depth = 10;
        qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
        qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
        return publisher_->create_datawriter(topic<Type>(name), qos);
    }
    template <class Type, class T> void listen(const std::string& name, bool is_latched = false) {
        DataReaderQos qos = DATAREADER_QOS_DEFAULT;
        qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
        qos.durability().kind = is_latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
        qos.history().depth = 10;
        qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
        subscriber_->create_datareader(topic<Type>(name), qos, new Listener<T>(name));
    }
private:
    template <class Type> Topic* topic(const std::string& name) {
        TypeSupport type(new Type());
        type.register_type(participant_);
        return participant_->create_topic("rt" + name, type.get_type_name(), TOPIC_QOS_DEFAULT);
    }
    DomainParticipant* participant_;
    Publisher* publisher_;
    Subscriber* subscriber_;
};

void stamp(std_msgs::msg::dds_::Header_& header, long long ns, const char* frame) {
    header.stamp().sec(int32_t(ns / 1000000000LL));
    header.stamp().nanosec(uint32_t(ns % 1000000000LL));
    header.frame_id(frame);
}

// Range to the walls of a room of 7.3 by 5.1 m, around (0.8, 0.4), with a post in it.
double range(const Motion& m, double bearing) {
    const double c = std::cos(m.theta + bearing), s = std::sin(m.theta + bearing);
    const double to_x = ((c > 0 ? 4.45 : -2.85) - m.x) / c, to_y = ((s > 0 ? 2.95 : -2.15) - m.y) / s;
    double found = std::min(std::abs(c) > 1e-9 ? to_x : 1e9, std::abs(s) > 1e-9 ? to_y : 1e9);
    const double px = 2.6 - m.x, py = 1.3 - m.y, along = c * px + s * py, off = c * py - s * px;
    if (along > 0 && std::abs(off) < 0.25) found = std::min(found, along - std::sqrt(0.0625 - off * off));
    return found;
}

class Robot {
public:
    Robot(Peer& peer, const Options& o) : options_(o) {
        scans_ = peer.writer<sensor::LaserScan_PubSubType>("/scan", !o.is_best_effort);
        odometry_ = peer.writer<nav::Odometry_PubSubType>("/odom", !o.is_best_effort);
        static_ = peer.writer<tf::TFMessage_PubSubType>("/tf_static", true, true);
        tf::TFMessage_ links;
        links.transforms().resize(1);
        auto& link = links.transforms()[0];
        stamp(link.header(), now_ns(), "base_link");
        link.child_frame_id("laser");
        link.transform().rotation().w(1.0);
        static_->write(&links);
    }
    // Drive for a hundredth of a second; the scan is due every so many.
    void step(int k) {
        {
            std::lock_guard<std::mutex> guard(lock);
            if (!options_.obeys) {
                const double way = std::sin(0.9 * since_s()) + std::sin(1.37 * since_s());
                speed = 0.12; turn_rate = way > 0.8 ? 0.9 : way < -1.2 ? -0.6 : 0.0;
            } else if (since_s() - commanded_s > 0.3) {
                speed = turn_rate = 0.0;
            }
            motion_.theta += 0.01 * turn_rate;
            motion_.x += 0.01 * speed * std::cos(motion_.theta);
            motion_.y += 0.01 * speed * std::sin(motion_.theta);
            truth[now_ns()] = motion_;
        }
        if (k % 2 == 0) send_odometry();
        if (k % std::max(1, int(100.0 / options_.hz)) == 0) send_scan();
    }
private:
    static long long now_ns() {
        return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::system_clock::now().time_since_epoch()).count();
    }
    void send_odometry() {
        nav::Odometry_ m;
        stamp(m.header(), now_ns(), "odom");
        m.child_frame_id("base_link");
        m.pose().pose().position().x(motion_.x);
        m.pose().pose().position().y(motion_.y);
        m.pose().pose().orientation().z(std::sin(0.5 * motion_.theta));
        m.pose().pose().orientation().w(std::cos(0.5 * motion_.theta));
        odometry_->write(&m);
    }
    void send_scan() {
        sensor::LaserScan_ m;
        stamp(m.header(), now_ns() + (long long)(1e9 * options_.ahead_s), "laser");
        const double step = 2.0 * M_PI / options_.beams;
        m.angle_min(float(-M_PI)); m.angle_max(float(M_PI - step)); m.angle_increment(float(step));
        m.range_min(0.05f); m.range_max(12.0f);
        for (int k = 0; k < options_.beams; ++k) m.ranges().push_back(float(range(motion_, -M_PI + k * step)));
        scans_->write(&m);
    }
    Options options_;
    Motion motion_;
    DataWriter *scans_, *odometry_, *static_;
};

Options parsed(int argc, char** argv) {
    Options o;
    for (int k = 1; k < argc; ++k) {
        const std::string word = argv[k];
        const auto next = [&] { return k + 1 < argc ? argv[++k] : "0"; };
        if (word == "--domain") o.domain = std::atoi(next());
        else if (word == "--seconds") o.seconds = std::atof(next());
        else if (word == "--hz") o.hz = std::atof(next());
        else if (word == "--beams") o.beams = std::atoi(next());
        else if (word == "--ahead") o.ahead_s = std::atof(next());
        else if (word == "--peer") o.peer = next();
        else if (word == "--listen") o.listens = true;
        else if (word == "--obey") o.obeys = true;
        else if (word == "--no-map") o.takes_map = false;
        else if (word == "--best-effort") o.is_best_effort = true;
        else { std::fprintf(stderr, "%s: unknown\n", word.c_str()); std::exit(2); }
    }
    return o;
}

int main(int argc, char** argv) {
    const Options options = parsed(argc, argv);
    for (int name : {SIGINT, SIGTERM}) std::signal(name, [](int) { is_over = true; });
    Peer peer(options);
    peer.listen<geometry::PoseWithCovarianceStamped_PubSubType, geometry::PoseWithCovarianceStamped_>("/pose");
    peer.listen<tf::TFMessage_PubSubType, tf::TFMessage_>("/tf");
    if (options.takes_map) peer.listen<nav::OccupancyGrid_PubSubType, nav::OccupancyGrid_>("/map", true);
    if (options.obeys) peer.listen<geometry::Twist_PubSubType, geometry::Twist_>("/cmd_vel");
    const auto now = std::chrono::system_clock::now().time_since_epoch();
    std::printf("%.3f\n", std::chrono::duration<double>(now).count());  // when it has joined
    std::fflush(stdout);
    std::unique_ptr<Robot> robot(options.listens ? nullptr : new Robot(peer, options));
    auto due = Clock::now();
    for (int k = 0; !is_over && since_s() < options.seconds; ++k) {
        if (robot) robot->step(k);
        due += std::chrono::milliseconds(10);
        std::this_thread::sleep_until(due);
    }
    std::lock_guard<std::mutex> guard(lock);
    std::printf("{");
    for (auto& [name, of] : heard)
        std::printf("\"%s\": {\"count\": %d, \"first_s\": %.2f, \"gap_p99_s\": %.3f, \"gap_max_s\": %.3f}, ", name.c_str(),
                    of.count, of.first_s, of.gap(0.99), of.gap(1.0));
    std::printf("\"worst_m\": %.4f, \"map_bytes\": %zu, \"obstacles\": %zu}\n", worst_m, map_bytes,
                obstacles);
    std::fflush(stdout);
    return 0;
}
