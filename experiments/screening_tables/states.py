import json, sys, numpy as np
rows=[json.loads(l) for l in open(sys.argv[1])]
rng=np.random.default_rng(0)
def table(states, label):
    # states: list of (scene, info, before(list), achieved(list of dict) )
    names=list(states[0][1]["choices"])
    print(f"## {label}: {len(states)} states of {len({s for s,*_ in states})} scenes")
    print("strategy       s    rate(pred) rate(again) ratio  [95% by scene]   | achieved: gain/s ratio [95%]  err after")
    scenes=sorted({s for s,*_ in states})
    def agg(name, key, chosen):
        g=sum(np.log(i["present"]/i["choices"][name][key]) for s,i,_,_ in chosen); t=sum(i["choices"][name]["seconds"] for s,i,_,_ in chosen)
        return g/t
    def mean_rate(name,key,chosen):
        return np.mean([np.log(i["present"]/i["choices"][name][key])/i["choices"][name]["seconds"] for s,i,_,_ in chosen])
    def ach(name, chosen):
        g=sum(np.mean(np.log(np.array(b)))-np.mean(np.log([x[name] for x in a])) for s,i,b,a in chosen); t=sum(i["choices"][name]["seconds"] for s,i,_,_ in chosen)
        return g/t
    by={s:[x for x in states if x[0]==s] for s in scenes}
    boots=[[x for s in rng.choice(scenes,len(scenes)) for x in by[s]] for _ in range(400)]
    for n in names:
        r=[mean_rate(n,"again",b)/mean_rate("regions","again",b) for b in boots]
        line=f"{n:12s} {np.mean([i['choices'][n]['seconds'] for _,i,_,_ in states]):5.2f}  {mean_rate(n,'predicted',states):.3f}     {mean_rate(n,'again',states):.3f}    {mean_rate(n,'again',states)/mean_rate('regions','again',states):.2f} [{np.quantile(r,.025):.2f} {np.quantile(r,.975):.2f}]"
        if n in states[0][3][0]:
            q=[ach(n,b)/ach("regions",b) for b in boots]
            line+=f"  | {ach(n,states):.3f} {ach(n,states)/ach('regions',states):.2f} [{np.quantile(q,.025):.2f} {np.quantile(q,.975):.2f}] {1000*np.mean([np.mean([x[n] for x in a]) for _,_,_,a in states]):.2f} mm"
        print(line)
    print("present (stated)", np.mean([1000*i["present"] for _,i,_,_ in states]), "true before", np.mean([1000*np.mean(b) for _,_,b,_ in states]))
    print("fast spearman", np.mean([i["fast_spearman"] for _,i,_,_ in states]), "analytic spearman", np.mean([i["analytic_spearman"] for _,i,_,_ in states]), "rate quantiles 5 25 50 75 95 99 max", np.mean([i["rate_quantiles"] for _,i,_,_ in states],axis=0).round(3))
    print("lengths regions choice", np.quantile([i["choices"]["regions"]["length"] for _,i,_,_ in states],[.1,.5,.9]).round(3), "all", np.quantile([i["choices"]["all"]["length"] for _,i,_,_ in states],[.1,.5,.9]).round(3), "kinds all", {k:sum(i["choices"]["all"]["kind"]==k for _,i,_,_ in states) for k in ("region","random","line")})
    print("clock plan, fast, analytic, refine", np.mean([i["clock"] for _,i,_,_ in states],axis=0).round(2), "pool", {k:np.mean([i["pool"][k] for _,i,_,_ in states]) for k in ("region","random","line")})
table([(r["mesh"],r["first"],r["first"]["before"],r["first"]["achieved"]) for r in rows],"first scan")
table([(r["mesh"],i,i["before"],i["achieved"]) for r in rows for i in r["second"]],"second scan")
