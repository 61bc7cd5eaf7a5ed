// A ROS 2 node as rmw_fastrtps would make it. It publishes or subscribes to every type of the
// pairings, with their names and already serialized messages. See ../README.md.
//
// fastdds-any talk FOLDER PREFIX KEY=PACKAGE/msg/NAME...
// fastdds-any listen FOLDER PREFIX[,PREFIX...] KEY=PACKAGE/msg/NAME...
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <memory>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

using namespace eprosima::fastdds::dds;
using namespace eprosima::fastrtps::rtps;
using eprosima::fastdds::rtps::UDPv4TransportDescriptor;
using Bytes = std::string;

namespace {

[[noreturn]] void fail(const std::string& what) {
    std::fprintf(stderr, "fastdds-any: %s; see tests/peers/README.md\n", what.c_str());
    std::exit(2);
}

// A type known by its name only. A message consists of its bytes, with the encapsulation in front.
class Laid : public TopicDataType {
public:
    explicit Laid(const std::string& name) {
        setName(name.c_str());
        m_typeSize = 2 << 20;
        m_isGetKeyDefined = false;
        auto_fill_type_object(false);
        auto_fill_type_information(false);
    }

    bool serialize(void* data, SerializedPayload_t* payload) override {
        const auto& bytes = *static_cast<Bytes*>(data);
        if (payload->max_size < bytes.size()) return false;
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = bytes[1] & 1 ? CDR_LE : CDR_BE;
        return true;
    }

    bool deserialize(SerializedPayload_t* payload, void* data) override {
        static_cast<Bytes*>(data)->assign(reinterpret_cast<char*>(payload->data), payload->length);
        return true;
    }

    std::function<uint32_t()> getSerializedSizeProvider(void* data) override {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes*>(data)->size()); };
    }

    void* createData() override { return new Bytes; }
    void deleteData(void* data) override { delete static_cast<Bytes*>(data); }
    bool getKey(void*, InstanceHandle_t*, bool) override { return false; }
};

// std_msgs/msg/String: std_msgs::msg::dds_::String_
std::string dds_name(const std::string& ros) {
    const auto slash = ros.rfind('/');
    const auto package = ros.find('/');
    if (slash == std::string::npos || package == slash) fail("not a type: " + ros);
    return ros.substr(0, package) + "::msg::dds_::" + ros.substr(slash + 1) + "_";
}

Bytes read(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    if (!file) fail("cannot read " + path);
    return {std::istreambuf_iterator<char>(file), {}};
}

DomainParticipant* participant() {
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    // UDP alone: two Fast DDS programs on one machine would otherwise communicate through shared
    // memory, past the network.
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(std::make_shared<UDPv4TransportDescriptor>());
    auto* p = DomainParticipantFactory::get_instance()->create_participant(0, qos);
    if (p == nullptr) fail("no participant");
    return p;
}

template <class Q> Q reliable(Q q) {
    q.reliability().kind = RELIABLE_RELIABILITY_QOS;
    q.history().kind = KEEP_LAST_HISTORY_QOS;
    q.history().depth = 10;
    q.endpoint().history_memory_policy = PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    q.data_sharing().off();
    return q;
}

// Compares everything after the encapsulation; a middleware may pad the last word with zeros.
bool same(const Bytes& got, const Bytes& sample) {
    if (got.size() < sample.size() || got.size() - sample.size() > 3) return false;
    const bool zeros = std::all_of(got.begin() + sample.size(), got.end(), [](char c) { return c == 0; });
    return zeros && got.compare(4, sample.size() - 4, sample, 4) == 0;
}

}  // namespace

int main(int argc, char** argv) {
    if (argc < 5) fail("talk or listen, a folder, prefixes and types");
    const std::string verb = argv[1], folder = argv[2];
    std::setvbuf(stdout, nullptr, _IOLBF, 0);
    auto* p = participant();
    std::map<std::string, Bytes> samples;
    std::map<std::string, std::string> types;
    for (int i = 4; i < argc; ++i) {
        const std::string pair = argv[i], key = pair.substr(0, pair.find('='));
        types[key] = dds_name(pair.substr(key.size() + 1));
        samples[key] = read(folder + "/" + key + ".cdr");
        TypeSupport(new Laid(types[key])).register_type(p);
    }
    std::vector<std::string> prefixes;
    std::istringstream list(argv[3]);
    for (std::string prefix; std::getline(list, prefix, ',');) prefixes.push_back(prefix);

    if (verb == "talk") {
        auto* publisher = p->create_publisher(PUBLISHER_QOS_DEFAULT);
        DataWriterQos qos = reliable(DATAWRITER_QOS_DEFAULT);
        qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
        std::map<std::string, DataWriter*> writers;
        for (const auto& [key, type] : types)
            writers[key] = publisher->create_datawriter(p->create_topic("rt" + prefixes[0] + "/" + key, type, TOPIC_QOS_DEFAULT), qos);
        std::printf("{\"event\":\"ready\"}\n");
        for (;;) {
            for (auto& [key, writer] : writers) writer->write(&samples[key]);
            std::this_thread::sleep_for(std::chrono::milliseconds(500));
        }
    }

    auto* subscriber = p->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    std::map<std::string, std::pair<std::string, DataReader*>> readers;
    for (const auto& prefix : prefixes)
        for (const auto& [key, type] : types) {
            const std::string name = prefix + "/" + key;
            readers[name] = {key, subscriber->create_datareader(p->create_topic("rt" + name, type, TOPIC_QOS_DEFAULT), reliable(DATAREADER_QOS_DEFAULT))};
        }
    std::printf("{\"event\":\"ready\"}\n");
    Bytes message;
    SampleInfo info;
    for (;; std::this_thread::sleep_for(std::chrono::milliseconds(20)))
        for (auto& [name, reader] : readers)
            while (reader.second->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK)
                if (info.valid_data)
                    std::printf("{\"event\":\"message\",\"topic\":\"%s\",\"same\":%s}\n", name.c_str(),
                                same(message, samples[reader.first]) ? "true" : "false");
}
