// A ROS 2 server or client of example_interfaces/srv/AddTwoInts as rmw_fastrtps would make it. See
// README.md.
#include "AddTwoIntsPubSubTypes.h"

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>

#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <memory>
#include <string>
#include <thread>

using namespace eprosima::fastdds::dds;
using namespace eprosima::fastrtps::rtps;
using Request = example_interfaces::srv::dds_::AddTwoInts_Request_;
using Response = example_interfaces::srv::dds_::AddTwoInts_Response_;

namespace {

template <class Type> Topic* topic(DomainParticipant* p, const std::string& name) {
    TypeSupport type(new Type());
    type.register_type(p);
    return p->create_topic(name, type.get_type_name(), TOPIC_QOS_DEFAULT);
}

DataReader* reader(DomainParticipant* p, Topic* topic) {
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.history().depth = 10;
    return p->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic, qos);
}

DataWriter* writer(DomainParticipant* p, Topic* topic) {
    DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = VOLATILE_DURABILITY_QOS;
    qos.history().depth = 10;
    return p->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic, qos);
}

void serve(DataReader* requests, DataWriter* replies) {
    Request request;
    SampleInfo info;
    for (;;) {
        requests->wait_for_unread_message({1, 0});
        while (requests->take_next_sample(&request, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            // The client's reader of replies, if the client named it; otherwise its writer.
            SampleIdentity asked = info.sample_identity;
            const GUID_t& named = info.related_sample_identity.writer_guid();
            if (named != GUID_t::unknown()) asked.writer_guid(named);
            WriteParams params;
            params.related_sample_identity(asked);
            Response response;
            response.sum(request.a() + request.b());
            replies->write(&response, params);
        }
    }
}

bool call(DataReader* replies, DataWriter* requests, long long a, long long b) {
    PublicationMatchedStatus matched;
    SubscriptionMatchedStatus heard;
    do {
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
        requests->get_publication_matched_status(matched);
        replies->get_subscription_matched_status(heard);
    } while (matched.current_count == 0 || heard.current_count == 0);
    // Both ends must have discovered each other, but only one end's discovery is visible here.
    for (int attempt = 0; attempt < 100; ++attempt) {
        Request request;
        request.a(a);
        request.b(b);
        WriteParams params;
        params.related_sample_identity().writer_guid(replies->guid());
        requests->write(&request, params);
        Response response;
        SampleInfo info;
        while (replies->wait_for_unread_message({0, 200000000})) {
            if (replies->take_next_sample(&response, &info) != ReturnCode_t::RETCODE_OK || !info.valid_data) continue;
            const SampleIdentity& answered = info.related_sample_identity;
            if (answered.writer_guid() == replies->guid() &&
                answered.sequence_number() == params.sample_identity().sequence_number()) {
                std::printf("{\"event\":\"reply\",\"sum\":%lld}\n", static_cast<long long>(response.sum()));
                return true;
            }
        }
    }
    return false;
}

}  // namespace

// fastdds-service-peer serve|call DOMAIN SERVICE [A B]
int main(int argc, char** argv) {
    if (argc < 4) {
        std::fprintf(stderr, "fastdds-service-peer serve|call DOMAIN SERVICE [A B]\n");
        return 2;
    }
    std::setvbuf(stdout, nullptr, _IOLBF, 0);
    const std::string verb = argv[1], service = argv[3];
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>());
    auto* p = DomainParticipantFactory::get_instance()->create_participant(std::atoi(argv[2]), qos);
    if (p == nullptr) return 1;
    using namespace example_interfaces::srv::dds_;
    auto* requests = topic<AddTwoInts_Request_PubSubType>(p, "rq" + service + "Request");
    auto* replies = topic<AddTwoInts_Response_PubSubType>(p, "rr" + service + "Reply");
    if (verb == "serve") {
        auto* in = reader(p, requests);
        auto* out = writer(p, replies);
        std::printf("{\"event\":\"ready\"}\n");
        serve(in, out);
    }
    auto* in = reader(p, replies);
    auto* out = writer(p, requests);
    std::printf("{\"event\":\"ready\"}\n");
    return argc == 6 && call(in, out, std::atoll(argv[4]), std::atoll(argv[5])) ? 0 : 1;
}
