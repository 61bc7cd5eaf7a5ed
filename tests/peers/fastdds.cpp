// A ROS 2 talker or listener as rmw_fastrtps would make it (std_msgs/msg/String). See README.md.
#include "StringPubSubTypes.h"

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <fastrtps/utils/IPLocator.h>

#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cinttypes>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <type_traits>
#include <vector>

using namespace eprosima::fastdds::dds;
using namespace eprosima::fastrtps::rtps;
using eprosima::fastdds::rtps::UDPv4TransportDescriptor;
using String = std_msgs::msg::dds_::String_;
using StringType = std_msgs::msg::dds_::String_PubSubType;

namespace {

struct Arguments {
    std::string verb, gate, topic = "rt/chatter", peer, security, text = "hello from the robot";
    int domain = 0, depth = 10, topics = 1;
    bool best_effort = false, transient_local = false, no_wait = false;
    uint64_t count = 0, size = 64;
    double rate = 10;
};

[[noreturn]] void usage(const std::string& what) {
    std::fprintf(stderr, "fastdds-peer: %s; see tests/peers/README.md\n", what.c_str());
    std::exit(2);
}

Arguments parse(int argc, char** argv) {
    Arguments a;
    if (argc < 2) usage("talk or listen?");
    a.verb = argv[1];
    if (a.verb != "talk" && a.verb != "listen") usage("unknown verb " + a.verb);
    for (int i = 2; i < argc; ++i) {
        std::string flag = argv[i];
        if (flag == "--best-effort") { a.best_effort = true; continue; }
        if (flag == "--transient-local") { a.transient_local = true; continue; }
        if (flag == "--no-wait") { a.no_wait = true; continue; }
        if (++i == argc) usage("no value for " + flag);
        std::string value = argv[i];
        if (flag == "--topic") a.topic = value;
        else if (flag == "--topics") a.topics = std::max(1, std::atoi(value.c_str()));
        else if (flag == "--peer") a.peer = value;
        else if (flag == "--security") a.security = value;
        else if (flag == "--gate") a.gate = value;
        else if (flag == "--text") a.text = value;
        else if (flag == "--domain") a.domain = std::atoi(value.c_str());
        else if (flag == "--depth") a.depth = std::atoi(value.c_str());
        else if (flag == "--count") a.count = std::strtoull(value.c_str(), nullptr, 10);
        else if (flag == "--size") a.size = std::strtoull(value.c_str(), nullptr, 10);
        else if (flag == "--rate") a.rate = std::atof(value.c_str());
        else usage("unknown argument " + flag);
    }
    return a;
}

int64_t monotonic_ns() {
    return std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

// Processes eight bytes at a time (Intel's "slicing by 8"): the checksum must not take the
// processor from the DDS under measurement.
uint32_t crc32(const char* data, size_t length) {
    static const auto table = [] {
        std::array<std::array<uint32_t, 256>, 8> t{};
        for (uint32_t i = 0; i < 256; ++i) {
            uint32_t c = i;
            for (int k = 0; k < 8; ++k) c = c & 1 ? 0xEDB88320u ^ (c >> 1) : c >> 1;
            t[0][i] = c;
        }
        for (uint32_t i = 0; i < 256; ++i)
            for (int k = 1; k < 8; ++k) t[k][i] = (t[k - 1][i] >> 8) ^ t[0][t[k - 1][i] & 0xFF];
        return t;
    }();
    uint32_t crc = ~0u;
    for (; length >= 8; data += 8, length -= 8) {
        uint32_t low, high;
        std::memcpy(&low, data, 4);
        std::memcpy(&high, data + 4, 4);
        low ^= crc;
        crc = table[7][low & 0xFF] ^ table[6][low >> 8 & 0xFF] ^ table[5][low >> 16 & 0xFF] ^ table[4][low >> 24] ^
              table[3][high & 0xFF] ^ table[2][high >> 8 & 0xFF] ^ table[1][high >> 16 & 0xFF] ^ table[0][high >> 24];
    }
    for (; length > 0; ++data, --length) crc = table[0][(crc ^ static_cast<uint8_t>(*data)) & 0xFF] ^ (crc >> 8);
    return ~crc;
}

// DDS Security as SROS 2 sets it up: authentication, access control and encryption by the plugins
// that every vendor has. The folder has one participant's files.
void secure(DomainParticipantQos& qos, const std::string& folder) {
    auto& properties = qos.properties().properties();
    auto set = [&](const std::string& name, const std::string& value) { properties.emplace_back(name, value); };
    auto file = [&](const char* name) { return "file://" + folder + "/" + name; };
    const std::string authentication = "dds.sec.auth.builtin.PKI-DH.", access = "dds.sec.access.builtin.Access-Permissions.";
    set("dds.sec.auth.plugin", "builtin.PKI-DH");
    set(authentication + "identity_ca", file("authority.crt"));
    set(authentication + "identity_certificate", file("identity.crt"));
    set(authentication + "private_key", file("identity.key"));
    set("dds.sec.access.plugin", "builtin.Access-Permissions");
    set(access + "permissions_ca", file("authority.crt"));
    set(access + "governance", file("governance.p7s"));
    set(access + "permissions", file("permissions.p7s"));
    set("dds.sec.crypto.plugin", "builtin.AES-GCM-GMAC");
}

DomainParticipant* participant(const Arguments& a) {
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    // UDP alone: two Fast DDS programs on one machine would otherwise communicate through shared
    // memory, past the network.
    auto transport = std::make_shared<UDPv4TransportDescriptor>();
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(transport);
    if (!a.peer.empty()) {
        auto& builtin = qos.wire_protocol().builtin;
        Locator_t peer;
        IPLocator::setIPv4(peer, a.peer);
        builtin.initialPeersList.push_back(peer);
        // An explicit unicast metatraffic locator turns multicast off.
        Locator_t any;
        builtin.metatrafficUnicastLocatorList.push_back(any);
    }
    if (!a.security.empty()) secure(qos, a.security);
    auto* p = DomainParticipantFactory::get_instance()->create_participant(a.domain, qos);
    if (p == nullptr) { std::fprintf(stderr, "fastdds-peer: no participant in domain %d\n", a.domain); std::exit(1); }
    return p;
}

template <class Q> void common_qos(Q& q, const Arguments& a) {
    q.reliability().kind = a.best_effort ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
    q.durability().kind = a.transient_local ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    q.history().kind = KEEP_LAST_HISTORY_QOS;
    // The reader's thread may take samples in bursts. A volatile reader therefore has a deeper
    // history than its writer.
    bool of_reader = std::is_same<Q, DataReaderQos>::value;
    q.history().depth = of_reader && !a.transient_local ? std::max(a.depth, 400) : a.depth;
    q.endpoint().history_memory_policy = PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    q.data_sharing().off();
}

void sleep_forever() {
    for (;;) std::this_thread::sleep_for(std::chrono::hours(1));
}

void talk(const Arguments& a, DomainParticipant* p, const std::vector<Topic*>& topics) {
    DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
    common_qos(qos, a);
    qos.publish_mode().kind = a.size > 60000 ? ASYNCHRONOUS_PUBLISH_MODE : SYNCHRONOUS_PUBLISH_MODE;
    auto* publisher = p->create_publisher(PUBLISHER_QOS_DEFAULT);
    std::vector<DataWriter*> writers;
    for (auto* topic : topics) writers.push_back(publisher->create_datawriter(topic, qos));
    std::printf("{\"event\":\"ready\"}\n");
    for (auto* writer : writers)
        for (PublicationMatchedStatus status; !a.no_wait;) {
            writer->get_publication_matched_status(status);
            if (status.current_count > 0) break;
            std::this_thread::sleep_for(std::chrono::milliseconds(10));
        }
    std::printf("{\"event\":\"matched\"}\n");
    std::string filler;
    const size_t room = a.size > 43 ? a.size - 43 : 0;
    while (filler.size() < room) filler += a.text + " ";
    filler.resize(room);
    const uint32_t crc = crc32(filler.data(), filler.size());
    String message;
    auto write = [&](DataWriter* writer, int64_t sequence) {
        char head[64];
        std::snprintf(head, sizeof head, "%010" PRId64 " %020" PRId64 " %010" PRIu32 " ", sequence, monotonic_ns(), crc);
        message.data(head + filler);
        writer->write(&message);
    };
    while (!a.gate.empty() && access(a.gate.c_str(), F_OK) != 0) {
        for (auto* writer : writers) write(writer, -1);
        std::this_thread::sleep_for(std::chrono::duration<double>(writers.size() / a.rate));
    }
    const auto start = std::chrono::steady_clock::now();
    for (uint64_t sequence = 0; a.count == 0 || sequence < a.count; ++sequence) {
        std::this_thread::sleep_until(start + std::chrono::duration<double>(sequence / a.rate));
        write(writers[sequence % writers.size()], static_cast<int64_t>(sequence));
    }
    std::printf("{\"event\":\"done\",\"sent\":%" PRIu64 "}\n", a.count);
    sleep_forever();
}

void report(const std::string& data, int64_t now, size_t topic) {
    long long sequence = -1, clock = now;
    unsigned long crc = 0;
    int used = 0;
    const bool parsed = std::sscanf(data.substr(0, 64).c_str(), "%lld %lld %lu%n", &sequence, &clock, &crc, &used) == 3;
    const size_t filler = std::min<size_t>(data.size(), parsed ? used + 1 : 0);
    const bool intact = parsed && crc32(data.data() + filler, data.size() - filler) == crc;
    std::string text = data.substr(filler, 40);
    for (char& c : text)
        if (c < 0x20 || c == '"' || c == '\\' || c > 0x7e) c = '?';
    std::printf("{\"event\":\"message\",\"seq\":%lld,\"latency_ns\":%lld,\"bytes\":%zu,\"intact\":%s,\"topic\":%zu,\"text\":\"%s\"}\n",
                sequence, static_cast<long long>(now - clock), data.size(), intact ? "true" : "false", topic, text.c_str());
}

// Takes samples on a separate thread, as a ROS executor does. Slow work here does not delay Fast
// DDS's reception.
void take(DataReader* reader, size_t topic) {
    String message;
    SampleInfo info;
    for (bool matched = false;;) {
        const bool some = reader->wait_for_unread_message({0, 100000000});
        SubscriptionMatchedStatus status;
        if (!matched && reader->get_subscription_matched_status(status) == ReturnCode_t::RETCODE_OK && status.current_count > 0) {
            matched = true;
            std::printf("{\"event\":\"matched\"}\n");
        }
        while (some && reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK) {
            const int64_t now = monotonic_ns();
            if (info.valid_data) report(message.data(), now, topic);
        }
    }
}

void listen(const Arguments& a, DomainParticipant* p, const std::vector<Topic*>& topics) {
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    common_qos(qos, a);
    auto* subscriber = p->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    std::vector<DataReader*> readers;
    for (auto* topic : topics) readers.push_back(subscriber->create_datareader(topic, qos));
    std::printf("{\"event\":\"ready\"}\n");
    std::vector<std::thread> takers;
    for (size_t i = 0; i < readers.size(); ++i) takers.emplace_back(take, readers[i], i);
    for (auto& taker : takers) taker.join();
}

}  // namespace

int main(int argc, char** argv) {
    const Arguments a = parse(argc, argv);
    std::setvbuf(stdout, nullptr, _IOLBF, 0);
    auto* p = participant(a);
    TypeSupport type(new StringType());
    type.register_type(p);
    std::vector<Topic*> topics;
    for (int i = 0; i < a.topics; ++i) {
        const std::string name = a.topic + (i == 0 ? "" : std::to_string(i));
        topics.push_back(p->create_topic(name, type.get_type_name(), TOPIC_QOS_DEFAULT));
    }
    a.verb == "talk" ? talk(a, p, topics) : listen(a, p, topics);
}
