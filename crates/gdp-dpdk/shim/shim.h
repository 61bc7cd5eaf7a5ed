/* What of DPDK is inline in its headers, as functions; and all that bindgen reads. */
#ifndef GDP_DPDK_SHIM_H
#define GDP_DPDK_SHIM_H

#include <rte_dev.h>
#include <rte_eal.h>
#include <rte_errno.h>
#include <rte_ethdev.h>
#include <rte_lcore.h>
#include <rte_log.h>
#include <rte_mbuf.h>
#include <rte_mbuf_pool_ops.h>
#include <rte_mempool.h>

/* Macros that bindgen does not see through. */
static const uint64_t GDP_GATHERS = RTE_ETH_TX_OFFLOAD_MULTI_SEGS;
static const uint64_t GDP_SPREAD_BY = RTE_ETH_RSS_IP | RTE_ETH_RSS_UDP;
/* The bytes of such an mbuf are not in its own memory. */
static const uint64_t GDP_ELSEWHERE = RTE_MBUF_F_INDIRECT | RTE_MBUF_F_EXTERNAL;

/* The error of the last call that failed on this thread. */
int gdp_errno(void);

uint16_t gdp_rx_burst(uint16_t port, uint16_t queue, struct rte_mbuf **mbufs, uint16_t count);
uint16_t gdp_tx_burst(uint16_t port, uint16_t queue, struct rte_mbuf **mbufs, uint16_t count);

/* A pool of so many mbufs with `room` for a packet and its headroom; null if there is no memory. */
struct rte_mempool *gdp_pool_create(const char *name, unsigned int count, unsigned int cache, uint16_t room);

/* Each of one segment, with the usual headroom; 0, or a negative error if there are not so many. */
int gdp_alloc(struct rte_mempool *pool, struct rte_mbuf **mbufs, unsigned int count);
/* Whole chains. */
void gdp_free(struct rte_mbuf **mbufs, unsigned int count);
/* An mbuf of `pool` that refers to what `of`, of one segment, holds; null if there is none. */
struct rte_mbuf *gdp_refer(struct rte_mempool *pool, struct rte_mbuf *of);
/* Puts `tail` behind `head`. */
int gdp_chain(struct rte_mbuf *head, struct rte_mbuf *tail);

/* The segment behind this one; null if it is the last. */
struct rte_mbuf *gdp_next(struct rte_mbuf *mbuf);

#endif
